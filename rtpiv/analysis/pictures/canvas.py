"""Figures as all pictures have them; whoever draws takes them from here, and nobody else waits for matplotlib."""

import matplotlib
from matplotlib.figure import Figure as Figure

matplotlib.rcParams["text.parse_math"] = False  # a $ in the name of a file or body begins no formula
