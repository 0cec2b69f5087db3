"""Compiled loops over interrogation windows; numba and numpy only."""
