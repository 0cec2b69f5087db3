"""Compiled loops of the simulated flow: views, images, modes."""
