"""Named scenes and whole frame sets of them, for the demo and for tests."""
