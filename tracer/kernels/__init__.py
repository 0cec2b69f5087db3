"""Numba kernels: scalars and contiguous arrays in, results out, nothing else."""
