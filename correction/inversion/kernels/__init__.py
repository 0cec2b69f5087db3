"""Compiled search for the views of a node; numba and numpy only."""
