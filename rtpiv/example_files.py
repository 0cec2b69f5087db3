"""Folder of the example scenes, benches and plans: inside this package in a wheel, beside it in a checkout."""

from pathlib import Path


def examples() -> Path:
    """Return the folder of the examples, whose files are to be copied before they are changed."""
    here = Path(__file__).resolve().parent
    inside = here / "examples"
    return inside if inside.is_dir() else here.parent / "examples"
