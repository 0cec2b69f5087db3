"""The numbers that a fit may change, what holds them apart, and the least squares that finds them."""
