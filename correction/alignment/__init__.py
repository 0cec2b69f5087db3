"""Positions of camera and spheres, from one frame: the input of a bench that aligns itself."""
