"""What hangs on the target's stage: patterns and their places, and the true positions printed into a frame."""
