"""Kernels of what frames of the target show, see `correction.fit.seen`."""
