"""The simulated bench: real protocols, simulated physics."""
