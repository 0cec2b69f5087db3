"""What arrangements of camera and glass would show, before one is built."""
