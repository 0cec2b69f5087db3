"""Tracking of single particles, where they are too few for windows."""
