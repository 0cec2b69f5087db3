"""What judges the correction: PIV, uncertainty, figures of merit, report."""
