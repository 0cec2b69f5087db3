"""Whether the glass still stands where it was calibrated, told by the particles of a flow alone."""
