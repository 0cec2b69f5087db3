"""Positions of the balls of a new scene: in contact, but for a hundredth of a millimetre for rounding.

The plane is z = 0, the camera far above it.

    behind     one behind the other, on the camera's axis (also called row)
    beside     beside each other, along x (also called side)
    triangle   three beside each other, parallel to the plane, the camera's axis in the hole between them
    pyramid    four (three and one) or five (four and one) balls, the tip towards the camera
    sc         a bed, simple cubic: n balls along each side, n^3 in all
    bcc        a bed, body-centred: n^3 balls that do not touch, and one in contact with eight in each gap of them
    hcp        a bed, closest packing: layers of a hexagon, of a triangle between them, of the hexagon again
    tube       a glass tube along y, packed with rings of four balls, every other ring turned by 45 degrees

A bed of some layers has 3 x 3 balls in its top layer (hcp: a hexagon), and the next one in its hollows.
The layers of a tube are its rings; its light sheet runs down its axis.
"""

import math
from collections.abc import Sequence
from typing import Literal, get_args

Vector = tuple[float, float, float]
Arrangement = Literal["behind", "beside", "triangle", "pyramid", "sc", "bcc", "hcp", "tube", "row", "side"]
ALIASES = {"row": "behind", "side": "beside"}
ARRANGEMENTS = tuple(name for name in get_args(Arrangement) if name not in ALIASES)
BEDS = {"sc": (8, 27, 64), "bcc": (9, 35, 91), "hcp": (10, 17)}  # numbers of balls
LAYERED = (*BEDS, "tube")
AIR_MM = 0.01  # between balls, so that rounded positions do not overlap
TUBE_AIR_MM, TUBE_WALL = 0.2, 1.0 / 6.0  # between balls and wall; thickness of the wall in diameters of a ball
TUBE_PLANE = 2.0  # its axis, counted as the layers of other beds
ROD_LENGTH_MM = 60.0
ROD_GAP_MM = 0.01  # the same between balls and rods


def most_balls(arrangement: str) -> Sequence[int]:
    """Return how many balls an arrangement may have."""
    return {"triangle": (3,), "pyramid": (4, 5), **BEDS, "tube": ()}.get(arrangement, range(1, 9))


def usual(balls: int | None, arrangement: str | None) -> tuple[int, str]:
    """Return number and arrangement if only one of them, or none, is given; two in line show most."""
    if arrangement is None:
        return balls or 2, {3: "triangle", 4: "pyramid", 5: "pyramid"}.get(balls or 2, "behind")
    arrangement = ALIASES.get(arrangement, arrangement)
    counts = most_balls(arrangement)
    few = {"pyramid": 5, "behind": 2, "beside": 2}.get(arrangement, next(iter(counts), 0))
    return (balls if balls is not None else few), arrangement


def centres_mm(
    arrangement: str, balls: int, ball_mm: float, gap_mm: float, sizes_mm: Sequence[float] = ()
) -> list[Vector]:
    """Centres of the balls, the lowest `gap_mm` above the plane; of several sizes in a line, first the lowest."""
    apart = ball_mm + AIR_MM
    low = gap_mm + ball_mm / 2.0
    sizes = sizes_mm or [ball_mm] * balls
    along = [sum(sizes[:index]) + sizes[index] / 2.0 + AIR_MM * index for index in range(balls)]
    if arrangement == "behind":
        found = [(0.0, 0.0, gap_mm + z) for z in along]
    elif arrangement == "beside":
        middle = (sum(sizes) + AIR_MM * (balls - 1)) / 2.0
        found = [(x - middle, 0.0, gap_mm + size / 2.0) for x, size in zip(along, sizes, strict=True)]
    elif arrangement in BEDS:
        found = [(x, y, low + z) for x, y, z in _bed(arrangement, balls, apart)]
    elif arrangement == "triangle" or balls == 4:
        out = apart / math.sqrt(3.0)
        found = [(*_polar(out, degrees), low) for degrees in (90.0, 210.0, 330.0)]
        if balls == 4:
            found.append((0.0, 0.0, low + apart * math.sqrt(2.0 / 3.0)))
    else:
        half = apart / 2.0
        found = [(x * half, y * half, low) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        found.append((0.0, 0.0, low + apart / math.sqrt(2.0)))
    return [(round(x, 4), round(y, 4), round(z, 4)) for x, y, z in found]


def layers_mm(arrangement: str, layers: int, ball_mm: float) -> tuple[list[Vector], float]:
    """Centres of a bed of some layers about the axis, the lowest at z = 0, and the distance between its layers.

    Those of a tube are rings along y; the distance is that from its axis to the balls in front of it.
    """
    apart = ball_mm + AIR_MM
    if arrangement == "tube":
        far = apart / math.sqrt(2.0)
        up = math.sqrt(apart**2 - (2.0 * far * math.sin(math.pi / 8.0)) ** 2)
        turns = [
            (up * (k - 0.5 * (layers - 1)), 45.0 * (k % 2) + 90.0 * n) for k in range(layers) for n in range(4)
        ]
        rings = [(y, *_polar(far, degrees)) for y, degrees in turns]
        return [(x, y, z + far) for y, x, z in rings], far
    cell, up = apart, apart
    if arrangement == "bcc":
        cell, up = 2.0 * apart / math.sqrt(3.0), apart / math.sqrt(3.0)
    if arrangement == "hcp":
        up = apart * math.sqrt(2.0 / 3.0)
        kinds = _hcp_layers(apart)
    else:
        wide, narrow = (_square(side, cell) for side in (3, 2))
        kinds = [wide, narrow if arrangement == "bcc" else wide]
    return [(x, y, up * k) for k in range(layers) for x, y in kinds[(layers - 1 - k) % 2]], up


def tube_radii_mm(ball_mm: float) -> tuple[float, float]:
    """Outer and inner radius of a tube around rings of four balls."""
    inner = (ball_mm + AIR_MM) / math.sqrt(2.0) + 0.5 * ball_mm + TUBE_AIR_MM
    return round(inner + TUBE_WALL * ball_mm, 2), round(inner, 2)


def span_mm(centres: Sequence[Vector], ball_mm: float) -> tuple[float, float]:
    """Width and height of all balls together."""
    width, height = (max(c[axis] for c in centres) - min(c[axis] for c in centres) + ball_mm for axis in (0, 1))
    return width, height


def outline_mm(centres: Sequence[Vector], ball_mm: float, distance_mm: float) -> tuple[float, float]:
    """Width and height on the plane of the region that all balls hide from a camera on the axis.

    A side is where a plane through the pinhole touches a ball: L tan(angle of its centre + asin(R / distance)).
    """
    sides = []
    for axis in (0, 1):
        far = 0.0
        for centre in centres:
            aside, ahead = abs(centre[axis]), distance_mm - centre[2]
            away = math.hypot(aside, ahead)
            if ahead <= 0.0 or ball_mm / 2.0 >= away:
                return math.inf, math.inf
            angle = math.atan2(aside, ahead) + math.asin(ball_mm / 2.0 / away)
            far = max(far, distance_mm * math.tan(angle) if angle < math.pi / 2.0 else math.inf)
        sides.append(2.0 * far)
    return sides[0], sides[1]


def rods_mm(
    centres: Sequence[Vector], ball_mm: float, support_mm: float, sizes_mm: Sequence[float] = ()
) -> list[tuple[Vector, Vector]]:
    """Start and end of the rods that hold the lowest balls from below; none if they have no diameter."""
    if not support_mm:
        return []
    lowest, rods = min(y for _, y, _ in centres), []
    for (x, y, z), size in zip(centres, sizes_mm or [ball_mm] * len(centres), strict=True):
        top = y - (size / 2.0 + support_mm / 2.0 + ROD_GAP_MM)
        if y < lowest + 1e-3:
            rods.append(((x, round(top, 4), z), (x, round(top - ROD_LENGTH_MM, 4), z)))
    return rods


def _bed(arrangement: str, balls: int, apart: float) -> list[Vector]:
    """Centres of a packed bed about the axis, the lowest layer at z = 0, neighbours `apart`."""
    if arrangement == "hcp":  # a hexagon, and over every other of its hollows a ball
        up = apart * math.sqrt(2.0 / 3.0)
        hexagon, hollows = _hcp_layers(apart)
        layers = [hexagon, hollows, hexagon][: 2 if balls == 10 else 3]
        return [(x, y, k * up) for k, layer in enumerate(layers) for x, y in layer]
    side = round(balls ** (1.0 / 3.0)) if arrangement == "sc" else BEDS["bcc"].index(balls) + 2
    cell = apart if arrangement == "sc" else 2.0 * apart / math.sqrt(3.0)
    found = _cubes(side, cell, 0.0)
    return found if arrangement == "sc" else [*found, *_cubes(side - 1, cell, 0.5 * cell)]


def _hcp_layers(apart: float) -> list[list[tuple[float, float]]]:
    hexagon = [(0.0, 0.0), *(_polar(apart, 60.0 * k) for k in range(6))]
    return [hexagon, [_polar(apart / math.sqrt(3.0), 30.0 + 120.0 * k) for k in range(3)]]


def _square(side: int, cell: float) -> list[tuple[float, float]]:
    places = [cell * (k - 0.5 * (side - 1)) for k in range(side)]
    return [(x, y) for y in places for x in places]


def _cubes(side: int, cell: float, low: float) -> list[Vector]:
    return [(x, y, low + cell * k) for k in range(side) for x, y in _square(side, cell)]


def _polar(radius: float, degrees: float) -> tuple[float, float]:
    angle = math.radians(degrees)
    return radius * math.cos(angle), radius * math.sin(angle)
