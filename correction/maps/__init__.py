"""Maps from the plane to the frame that shows it, and the corrector that resamples by them."""
