"""Images of the simulated camera: an independent ray tracer, and the noise of its sensor."""
