"""Whether the fitted model is right, and which cause explains best what is left."""
