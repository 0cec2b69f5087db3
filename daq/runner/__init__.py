"""The runner: carries steps out on an open bench, journals them, and stops as it is asked to."""
