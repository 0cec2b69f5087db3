"""A flow for the simulated bench: known fields, particles in a light sheet, their images through glass."""
