"""Motion and time of the simulated world."""
