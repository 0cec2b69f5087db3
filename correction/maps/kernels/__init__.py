"""Compiled rounding of maps; numba and numpy only."""
