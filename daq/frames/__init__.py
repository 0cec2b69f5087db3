"""Frames that other programs have recorded: numbered files, pages, videos, DaVis, HDF5 and NeXus data sets."""
