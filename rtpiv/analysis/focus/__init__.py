"""Where a view through glass is sharp, and which aperture makes all of it sharp."""
