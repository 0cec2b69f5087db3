"""The scene fit: the true geometry of the bench from frames of the target."""
