"""Ways of tracing a scene: one ray, many rays, a whole sensor, and which way a scene gets."""
