"""Commercial calibration plates by name: dimensions that their names contain.

Kinds of boards are in `tracer.board` and `correction.target.board_file`; a plate here is only a name for one.

LaVision names its two-sided plates of two levels by width, distance of the dots on one level, and distance of
the levels [mm]: 106-10-2.  Dots of the other level stand in the middle of four, so that rows are staggered by half
a pitch.  Other figures are in no public document that could be verified: diameter and marks are measured by the
user, and so are plates of other makers.
"""

from typing import Any

LAVISION: dict[str, tuple[float, float]] = {  # pitch on one level and distance of the levels [mm]
    "lavision-025-3.3": (3.3, 1.0),
    "lavision-058-5": (5.0, 1.0),
    "lavision-106-10": (10.0, 2.0),
    "lavision-204-15": (15.0, 3.0),
    "lavision-309-15": (15.0, 3.0),
}


def with_plate(said: dict[str, Any]) -> dict[str, Any]:
    """Return the lines of a board file with those of the plate that it names; ValueError if there is none."""
    name = said["plate"]
    if name not in LAVISION:
        raise ValueError(
            f"no plate {name!r} is known; say one of {', '.join(LAVISION)}, or leave plate out and say its kind,"
            " pitch_mm, rows, levels and step_mm"
        )
    pitch_mm, step_mm = LAVISION[name]
    lines = {"kind": "dots", "pitch_mm": pitch_mm, "rows": "staggered", "bright_dots": True}
    return {**lines, "levels": "rows", "step_mm": step_mm, **said}
