"""Vectors for other people's tools."""
