"""Check by the particles of a flow alone that the glass still stands where it was calibrated."""
