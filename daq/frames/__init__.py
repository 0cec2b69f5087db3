"""Frames that other programs have recorded: numbered files, pages of a stack, an HDF5 or NeXus data set."""
