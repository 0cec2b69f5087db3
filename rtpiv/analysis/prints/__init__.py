"""Printed targets: boards and particles, on paper at true size."""
