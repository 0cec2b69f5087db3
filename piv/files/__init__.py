"""Frames on disk: read what cameras and other programs write."""
