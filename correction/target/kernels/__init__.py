"""Compiled fit of a corner's grey values; numba and numpy only."""
