"""What the frames of a target show: corners, outlines, which corner is which, what is smeared or hidden."""
