"""Lens and focal length of a camera from hand-held poses of a board."""
