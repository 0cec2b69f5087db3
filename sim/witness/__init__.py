"""The judge of a simulated bench: sees where everything really is, and asks nobody who works on the bench."""
