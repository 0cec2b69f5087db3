"""Where camera and spheres stand, from one frame: what a bench needs to bring them to their places."""
