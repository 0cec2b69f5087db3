"""Plans: a file becomes a flat list of steps that can be drawn, checked and timed before anything moves."""
