"""Compiled inner loops of the correction and of its evaluation; numba and numpy only."""
