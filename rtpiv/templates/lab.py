"""Description of a lab, and the imaging that follows from it by a thin lens.

A lens of focal length f focused on a plane at L has the magnification M = f / (L - f), so the plane is seen with
M / pixel pitch, and the sensor sees its own size divided by M.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

from pydantic import ConfigDict, TypeAdapter, ValidationError

from daq.errors import RunUsageError
from ground.config import Name
from ground.plain_words import slip
from rtpiv.analysis.prints.pages import whole_dots
from rtpiv.templates.arrangement import (
    ALIASES,
    ARRANGEMENTS,
    LAYERED,
    TUBE_AIR_MM,
    TUBE_PLANE,
    TUBE_WALL,
    Vector,
    centres_mm,
    layers_mm,
    most_balls,
    outline_mm,
    rods_mm,
    span_mm,
)
from tracer.media import ConstantMedium, Medium, media_names, medium_called

NAME = TypeAdapter(Name, config=ConfigDict(defer_build=True))
DENSEST = 4.0  # index
LEAST_SQUARE_PX = 20.0  # of the board, seen directly; behind glass it may be half
LEAST_BALL_PX, LEAST_CORNER_PX = 16.0, 4.0  # below, balls and squares are not resolved
LENSES_MM = (12.0, 16.0, 25.0, 35.0, 50.0, 60.0, 85.0, 105.0, 135.0, 180.0)
AROUND = 1.05  # of what the balls hide
LINES = ("behind", "beside")  # whose balls may differ
MOST_LAYERS = 7
MOST_DEG = 45.0  # of a camera that looks from the side
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
        One of `ARRANGEMENTS`, or of `ALIASES`.
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
    sizes_mm, glasses : tuple
        Diameter and glass of each ball behind or beside each other, where they differ, from the plane on or from
        the left;
        `ball_mm` is then the largest, `glass` the first.
    turn_deg : float
        By which the camera looks at the plane from the side, about the y axis.
    square_mm : float
        Square of the board; 0 for the smallest usual one that this camera resolves well.
    by_hand : bool
        Whether hands move target and glass, and no motor does.
    layers : int
        Layers of a bed in front of the board, in the midst of which the light sheet lies; 0: another arrangement.
    plane : float
        Layer in which the sheet lies, counted from the top: 1 through the centres of the top layer, 1.5 halfway to
        the next.

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
    arrangement: str = "behind"
    balls: int = 2
    ball_mm: float = 40.0
    gap_mm: float = 30.0
    glass: str = "acrylic"
    support_mm: float = 0.0
    wavelength_nm: float = 532.0
    sizes_mm: tuple[float, ...] = ()
    glasses: tuple[str, ...] = ()
    turn_deg: float = 0.0
    square_mm: float = 0.0
    by_hand: bool = False
    layers: int = 0
    plane: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "arrangement", ALIASES.get(self.arrangement, self.arrangement))
        if problems := list(self._problems()):
            raise RunUsageError("; ".join(problems))

    def _problems(self) -> list[str]:
        said = []
        try:
            NAME.validate_python(self.name)
        except ValidationError:
            said.append(f"name {self.name!r}: letters, digits and underscores, first a letter, 32 at most")
        lengths = ("pixel_pitch_um", "lens_mm", "distance_mm", "ball_mm", "wavelength_nm")
        for key in (*lengths, "gap_mm", "support_mm", "square_mm"):
            value = getattr(self, key)
            if not math.isfinite(value) or value < 0.0 or (value == 0.0 and key in lengths):
                said.append(f"{key}: should be a positive number, not {value:g}")
        if not all(16 <= side <= 65535 for side in self.sensor_px):
            said.append(f"sensor_px: should be width and height, 16 to 65535, not {self.sensor_px}")
        if self.arrangement not in ARRANGEMENTS:
            said.append(f"arrangement {self.arrangement!r}: there are {', '.join(ARRANGEMENTS)}")
        elif self.layers and self.arrangement not in LAYERED:
            said.append(f"layers: a bed has layers ({', '.join(LAYERED)}), not {self.arrangement!r}")
        elif self.arrangement == "tube" and not (1 <= self.layers <= MOST_LAYERS and self.plane == TUBE_PLANE):
            said.append(
                f"layers: a tube has 1 to {MOST_LAYERS} layers, rings of four balls, and its light sheet runs down"
                " its axis; give --layers, and leave --balls and --plane out"
            )
        elif (
            self.layers
            and not self.is_tube
            and not (self.layers <= MOST_LAYERS and 1.0 <= self.plane <= self.layers)
        ):
            said.append(
                f"layers, plane: should be 1 to {MOST_LAYERS} layers and a plane from 1, the top, to the last;"
                f" not {self.layers} and {self.plane:g}"
            )
        elif not self.layers and self.balls not in most_balls(self.arrangement):
            counts = ", ".join(map(str, most_balls(self.arrangement)))
            said.append(f"balls: a {self.arrangement} has {counts}, not {self.balls}")
        for glass in dict.fromkeys(self.each_glass):
            if _index(glass) is None and medium_called(glass) is None:
                said.append(f"glass {glass!r} is not known; known are {media_names()}, or its index, 1 to 4")
        for what, given in (("ball_mm", self.sizes_mm), ("glass", self.glasses)):
            if given and (self.arrangement not in LINES or len(given) != self.balls):
                said.append(
                    f"{what}: several are for balls behind or beside each other, one for each, not {len(given)}"
                )
        if self.sizes_mm and not all(0.0 < size <= self.ball_mm for size in self.sizes_mm):
            said.append("ball_mm: every size should be a positive number")
        if not abs(self.turn_deg) <= MOST_DEG:
            said.append(f"turn_deg: should be {-MOST_DEG:g} to {MOST_DEG:g}, not {self.turn_deg:g}")
        if not said and self.lens_mm >= self.distance_mm:
            said.append(f"a lens of {self.lens_mm:g} mm cannot focus on a plane {self.distance_mm:g} mm away")
        if not 300.0 <= self.wavelength_nm <= 2000.0:
            said.append(f"wavelength_nm: should be 300 to 2000, not {self.wavelength_nm:g}")
        return said

    @property
    def each_mm(self) -> tuple[float, ...]:
        """Diameter of every ball."""
        return self.sizes_mm or (self.ball_mm,) * self.balls

    @property
    def each_glass(self) -> tuple[str, ...]:
        """Glass of every ball."""
        return self.glasses or (self.glass,) * self.balls

    @property
    def centres_mm(self) -> list[Vector]:
        """Centre of every ball."""
        if self.layers:
            low = self.gap_mm + self.wall_mm + self.ball_mm / 2.0
            bed, _ = layers_mm(self.arrangement, self.layers, self.ball_mm)
            return [(round(x, 4), round(y, 4), round(z + low, 4)) for x, y, z in bed]
        return centres_mm(self.arrangement, self.balls, self.ball_mm, self.gap_mm, self.sizes_mm)

    @property
    def is_tube(self) -> bool:
        """Return whether the balls stand in a tube."""
        return self.arrangement == "tube"

    @property
    def beyond_mm(self) -> float:
        """Length of the tube beyond its balls at either end; 0 without one."""
        return self.ball_mm if self.is_tube else 0.0

    @property
    def wall_mm(self) -> float:
        """Wall of the tube and gap to its balls; 0 without one."""
        return TUBE_AIR_MM + TUBE_WALL * self.ball_mm if self.is_tube else 0.0

    @property
    def sheet_mm(self) -> float:
        """Height of the light sheet over the board; 0 where that hangs in its plane."""
        if not self.layers:
            return 0.0
        top = max(z for _, _, z in self.centres_mm)
        return round(top - (self.plane - 1.0) * layers_mm(self.arrangement, self.layers, self.ball_mm)[1], 2)

    @property
    def light_mm(self) -> int:
        """Width of the light of the sheet: across all balls, down the tube within its wall."""
        return math.floor(self.span_mm[0]) if self.is_tube else math.ceil(1.5 * max(self.span_mm))

    @property
    def sheet_clear_mm(self) -> float:
        """Distance from a sheet in a bed to the nearest ball that it does not cut; infinite without any."""
        gaps = (abs(z - self.sheet_mm) - self.ball_mm / 2.0 for _, _, z in self.centres_mm)
        return min((gap for gap in gaps if gap > 0.0), default=math.inf)

    @property
    def rods_mm(self) -> list[tuple[Vector, Vector]]:
        """Start and end of every rod."""
        return rods_mm(self.centres_mm, self.ball_mm, self.support_mm, self.sizes_mm)

    @property
    def pinhole_mm(self) -> Vector:
        """Position of the camera's pinhole; it looks at the origin."""
        turn = math.radians(self.turn_deg)
        x, z = self.distance_mm * math.sin(turn), self.distance_mm * math.cos(turn)
        return round(x, 4), 0.0, round(z, 4)

    @property
    def span_mm(self) -> tuple[float, float]:
        """Width and height of the balls together."""
        return span_mm(self.centres_mm, self.ball_mm)

    def with_equal_balls(self, **changes: Any) -> "Lab":  # noqa: ANN401 - of its fields
        """Return the lab with changes, and with balls of one size and glass."""
        return replace(self, sizes_mm=(), glasses=(), **changes)

    def with_usual_lens(self) -> "Lab":
        """Return the same lab with the longest lens that sees all balls from this distance."""
        found = [replace(self, lens_mm=f) for f in LENSES_MM if f < 0.8 * self.distance_mm] or [self]
        hidden = outline_mm(self.centres_mm, self.ball_mm, self.distance_mm)
        if self.layers and self.sheet_mm < self.distance_mm:  # what the sheet shows of the bed, seen on the board
            nearer = 1.0 - self.sheet_mm / self.distance_mm
            hidden = self.span_mm[0] / nearer, self.span_mm[1] / nearer
        width, height = (AROUND * side for side in hidden)
        height_mm = max(z for _, _, z in self.centres_mm) + self.ball_mm / 2.0
        width += (
            2.0 * height_mm * abs(math.tan(math.radians(self.turn_deg)))
        )  # what stands up is seen beside its place
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
    def too_small(self) -> str:
        """Objection to balls or squares below the camera's resolution, with the likely slip, or ""."""
        sizes = [("ball_mm", size, LEAST_BALL_PX) for size in self.each_mm] + [
            ("square_mm", self.board_mm, LEAST_CORNER_PX)
        ]
        for key, size, least_px in sizes:
            least_mm = least_px / self.px_per_mm
            if size < least_mm:
                hint = slip(key, size, least_mm, self.distance_mm)
                return (
                    f"{key}: {size:g} mm are {size * self.px_per_mm:.2g} px of this camera, too few to see{hint}"
                )
        return ""

    @property
    def board_mm(self) -> float:
        """Square of the board: the lab's, or one to print that this camera resolves well."""
        return self.square_mm or whole_dots(
            next((side for side in SQUARES_MM if side * self.px_per_mm >= LEAST_SQUARE_PX), SQUARES_MM[-1])
        )


def medium_of_glass(glass: str) -> Medium:
    """Return the medium of a ball, by name or index."""
    index = _index(glass)
    known = medium_called(glass) if index is None else ConstantMedium(index)
    assert known is not None  # others are refused
    return known


def _index(glass: str) -> float | None:
    """The glass as a number, if it is one that glass can have."""
    try:
        index = float(glass)
    except ValueError:
        return None
    return index if 1.0 < index <= DENSEST else None
