"""Frames that other programs have recorded: numbered files, pages of a stack, videos, HDF5 and NeXus data sets."""
