"""Where the example scenes, benches and plans lie: inside this package in a wheel, beside it in a checkout."""

from pathlib import Path


def examples() -> Path:
    """Return the folder of the examples; copy from it what you want to change."""
    here = Path(__file__).resolve().parent
    inside = here / "examples"
    return inside if inside.is_dir() else here.parent / "examples"
