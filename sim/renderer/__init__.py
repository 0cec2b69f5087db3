"""What the simulated camera sees: an independent ray tracer, and the noise of its sensor."""
