"""The judge of a simulated bench: sees where everything really is, and uses no reading of the bench."""
