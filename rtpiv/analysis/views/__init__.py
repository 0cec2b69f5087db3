"""Arrangements of camera and glass, compared before one is built."""
