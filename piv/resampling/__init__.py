"""The one resampler of the house: frames at any position between their pixels, with splines or bilinearly."""
