"""What judges the correction: routes, regions, shifts, targets, and the vectors on disk."""
