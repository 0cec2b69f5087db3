"""Compiled sampling of frames between their pixels; numba and numpy only."""
