"""Results in the browser: vectors over their frame, profiles, other windows, and post-processing by choice."""
