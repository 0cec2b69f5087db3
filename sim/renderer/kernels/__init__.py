"""Compiled loops of the renderer: rays from pixels to the plane, what they meet, what is printed there."""
