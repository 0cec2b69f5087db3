"""Numba and numpy only."""
