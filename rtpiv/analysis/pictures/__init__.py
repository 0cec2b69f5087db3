"""Pictures for people: drawn from maps and frames, never read back."""
