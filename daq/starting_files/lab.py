"""What a lab says of itself, and what follows from it by a thin lens.

A lens of focal length f focused on a plane at L has the magnification M = f / (L - f), so the plane is seen with
M / pixel pitch, and the sensor sees its own size divided by M.
"""

import math
from dataclasses import dataclass, replace

from pydantic import TypeAdapter, ValidationError

from daq.errors import RunUsageError
from daq.starting_files.arrangement import ARRANGEMENTS, centres_mm, most_balls, outline_mm, span_mm
from stages.config import Name
from tracer.media import ConstantMedium, Medium, known_media, medium_called

NAME = TypeAdapter(Name)
DENSEST = 4.0  # index
LEAST_SQUARE_PX = 20.0  # of the board, seen directly; behind glass it may be half
LENSES_MM = (12.0, 16.0, 25.0, 35.0, 50.0, 60.0, 85.0, 105.0, 135.0, 180.0)
AROUND = 1.05  # of what the balls hide
SQUARES_MM = (0.5, 1.0, 1.5, 2.5, 4.0, 5.0, 10.0, 20.0)


@dataclass(frozen=True)
class Lab:
    """A lab's camera, lens, glass and light; lengths in mm.

    Parameters
    ----------
    name : str
        Letters, digits, underscores.
    sensor_px : (int, int)
        Width and height of the camera's frames.
    pixel_pitch_um : float
        Size of a pixel.
    lens_mm : float
        Focal length.
    distance_mm : float
        From the lens (its pinhole) to the investigation plane.
    arrangement : str
        One of `ARRANGEMENTS`.
    balls : int
        How many.
    ball_mm : float
        Their diameter.
    gap_mm : float
        Between the lowest ball and the plane.
    glass : str
        What they are made of, or its index.
    support_mm : float
        Diameter of the opaque rods that hold them from below; 0 for none.
    wavelength_nm : float
        Of the light.

    Raises
    ------
    RunUsageError
        This cannot be; the sentence says which number and what would do.
    """

    name: str = "lab"
    sensor_px: tuple[int, int] = (1280, 1024)
    pixel_pitch_um: float = 4.8
    lens_mm: float = 35.0
    distance_mm: float = 500.0
    arrangement: str = "row"
    balls: int = 2
    ball_mm: float = 40.0
    gap_mm: float = 30.0
    glass: str = "acrylic"
    support_mm: float = 0.0
    wavelength_nm: float = 532.0

    def __post_init__(self) -> None:
        if problems := list(self._problems()):
            raise RunUsageError("; ".join(problems))

    def _problems(self) -> list[str]:
        said = []
        try:
            NAME.validate_python(self.name)
        except ValidationError:
            said.append(f"name {self.name!r}: letters, digits and underscores, first a letter, 32 at most")
        lengths = ("pixel_pitch_um", "lens_mm", "distance_mm", "ball_mm", "wavelength_nm")
        for key in (*lengths, "gap_mm", "support_mm"):
            value = getattr(self, key)
            if not math.isfinite(value) or value < 0.0 or (value == 0.0 and key in lengths):
                said.append(f"{key}: should be a positive number, not {value:g}")
        if not all(16 <= side <= 65535 for side in self.sensor_px):
            said.append(f"sensor_px: should be width and height, 16 to 65535, not {self.sensor_px}")
        if self.arrangement not in ARRANGEMENTS:
            said.append(f"arrangement {self.arrangement!r}: there are {', '.join(ARRANGEMENTS)}")
        elif self.balls not in most_balls(self.arrangement):
            counts = ", ".join(map(str, most_balls(self.arrangement)))
            said.append(f"balls: a {self.arrangement} has {counts}, not {self.balls}")
        if self._index is None and medium_called(self.glass) is None:
            said.append(f"glass {self.glass!r} is not known; known are {known_media()}, or its index, 1 to 4")
        if not said and self.lens_mm >= self.distance_mm:
            said.append(f"a lens of {self.lens_mm:g} mm cannot focus on a plane {self.distance_mm:g} mm away")
        if not 300.0 <= self.wavelength_nm <= 2000.0:
            said.append(f"wavelength_nm: should be 300 to 2000, not {self.wavelength_nm:g}")
        return said

    @property
    def _index(self) -> float | None:
        """The glass as a number, if it is one that glass can have."""
        try:
            index = float(self.glass)
        except ValueError:
            return None
        return index if 1.0 < index <= DENSEST else None

    @property
    def medium(self) -> Medium:
        """What the balls are made of."""
        known = medium_called(self.glass) if self._index is None else ConstantMedium(self._index)
        assert known is not None  # others are refused
        return known

    @property
    def span_mm(self) -> tuple[float, float]:
        """Width and height of the balls together."""
        centres = centres_mm(self.arrangement, self.balls, self.ball_mm, self.gap_mm)
        return span_mm(centres, self.ball_mm)

    def with_usual_lens(self) -> "Lab":
        """Return the same lab with the longest lens that sees all balls from this distance."""
        found = [replace(self, lens_mm=f) for f in LENSES_MM if f < 0.8 * self.distance_mm] or [self]
        centres = centres_mm(self.arrangement, self.balls, self.ball_mm, self.gap_mm)
        width, height = (AROUND * side for side in outline_mm(centres, self.ball_mm, self.distance_mm))
        wide = [lab for lab in found if lab.field_mm[0] >= width and lab.field_mm[1] >= height]
        return wide[-1] if wide else found[0]

    @property
    def px_per_mm(self) -> float:
        """Scale on the plane."""
        return self.lens_mm / (self.distance_mm - self.lens_mm) / (self.pixel_pitch_um * 1e-3)

    @property
    def field_mm(self) -> tuple[float, float]:
        """Width and height of what the camera sees of the plane without glass."""
        width, height = self.sensor_px
        return width / self.px_per_mm, height / self.px_per_mm

    @property
    def square_mm(self) -> float:
        """Square of a board that this camera resolves well."""
        return next((side for side in SQUARES_MM if side * self.px_per_mm >= LEAST_SQUARE_PX), SQUARES_MM[-1])
