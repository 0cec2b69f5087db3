"""Parts of the view that no map is to use, though rays get through.

A fit compares the frames of the target with what the fitted scene shows.  Where something stands that the scene
does not list, or where a ball is not known well enough, rays are traced as ever and mean nothing.  Such a part is
kept with the scene, so that it goes wherever the scene goes: an outline in the raw frame, or all that is seen
through one sequence of bodies.  What a person wants left out, such as a wall in the flow or a reflection, is an
outline too, in the raw frame or in the plane of the vectors, and no calibration takes it away.

**A mask that was drawn as a picture** (`left_out`) becomes outlines, as all that is masked; white is left out.
The picture is as large as the raw frame.  Outlines are drawn a third of a pixel outside the middles of white
pixels and no more than 0.3 px beside that, so they hold the same pixels, with few corners.  A hole in a white area
is joined to the area's outline by a cut of no width: what a ray crosses twice there it does not cross.  OpenCV
decodes the picture and follows its edges; it comes with rtpiv, and the tracer alone does without.
"""

import struct
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ground.plain_file import read_plain
from tracer.errors import SceneError

UNLISTED, UNCONFIRMED, LEFT_OUT = "unlisted body", "unconfirmed", "left out"
MOST_BYTES = 200_000_000  # of a picture
MOST_PARTS = 1000  # white areas
FINER = 3  # the outline passes a third of a pixel outside the middle of a pixel
BIG_TIFF, PHOTOMETRIC, MIN_IS_WHITE, MIN_IS_BLACK = 43, 262, 0, 1  # of the TIFF format
STRAIGHT_PX = 0.3  # less than that third
Point = tuple[float, float]


@dataclass(frozen=True)
class MaskedPart:
    """A part of the view that is not to be used.

    Parameters
    ----------
    why : {"unlisted body", "unconfirmed", "left out"}
        Something stands there that the scene does not list; the target did not confirm what the scene shows; or a
        person wants it so.
    outline_px : tuple of (float, float)
        Polygon u, v in the raw frame, three points or more.
    through : tuple of str
        Names of the bodies crossed, in order (``tracer.strategies.branches``).
    outline_mm : tuple of (float, float)
        Polygon x, y in the plane of the vectors, three points or more.

    Raises
    ------
    SceneError
        None of the three or several are given, or the outline is none.
    """

    why: str
    outline_px: tuple[Point, ...] = ()
    through: tuple[str, ...] = ()
    outline_mm: tuple[Point, ...] = ()

    def __post_init__(self) -> None:
        if self.why not in (UNLISTED, UNCONFIRMED, LEFT_OUT):
            raise SceneError(f"masked: why is {self.why!r}; give {LEFT_OUT!r}, {UNLISTED!r} or {UNCONFIRMED!r}")
        if sum(map(bool, (self.outline_px, self.through, self.outline_mm))) != 1:
            raise SceneError("masked: give outline_px, outline_mm or through, one of them")
        for name, outline in (("outline_px", self.outline_px), ("outline_mm", self.outline_mm)):
            if outline and (len(outline) < 3 or not np.isfinite(outline).all()):
                raise SceneError(f"masked: an {name} is a list of three points or more, two numbers each")

    def coarser(self, times: int) -> "MaskedPart":
        """Return the same before a camera with pixels `times` times wider."""
        if times == 1:
            return self
        outline = tuple(((u + 0.5) / times - 0.5, (v + 0.5) / times - 0.5) for u, v in self.outline_px)
        return replace(self, outline_px=outline)


def left_out(path: Path, sensor_px: tuple[int, int]) -> tuple[MaskedPart, ...]:
    """Return what a picture leaves out of a camera's frame.

    Parameters
    ----------
    path : Path
        PNG, TIFF, BMP or JPEG; what is above half of its largest number is left out, also of a TIFF whose numbers
        are shown inverted (MinIsWhite), as tifffile writes arrays of bool.
    sensor_px : (int, int)
        Width and height of the frame.

    Raises
    ------
    SceneError
        It cannot be read, has another size, leaves out nothing or all, or is made of more than a thousand parts.
    """
    white = _white(path, sensor_px)
    import cv2

    fine = np.pad(np.kron(white, np.ones((FINER, FINER), np.uint8)), 1)
    found, tree = cv2.findContours(fine, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    outlines = [_simplify(contour) for contour in found]
    areas = [k for k in range(len(outlines)) if tree[0][k][3] < 0]
    if len(areas) > MOST_PARTS:
        raise SceneError(f"mask {path}: white areas are {len(areas)}, and {MOST_PARTS} are taken; clean it up")
    parts = []
    for k in areas:
        outline, hole = outlines[k], tree[0][k][2]
        while hole >= 0:
            outline = _join_hole(outline, outlines[hole])
            hole = tree[0][hole][0]
        points: tuple[Point, ...] = tuple((round(u, 3), round(v, 3)) for u, v in outline.tolist())
        parts.append(MaskedPart(LEFT_OUT, outline_px=points))
    return tuple(parts)


def _white(path: Path, sensor_px: tuple[int, int]) -> NDArray[np.uint8]:
    """1 where the picture (H, W) is white."""
    try:
        import cv2
    except ImportError:  # the tracer alone
        raise SceneError(f"mask {path}: a picture needs OpenCV; install rtpiv, or give outline_px") from None
    try:
        content = read_plain(path, MOST_BYTES)
    except OSError as error:
        raise SceneError(f"mask {path}: cannot be read: {error.strerror or error}") from None
    how = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        picture: Any = cv2.imdecode(np.frombuffer(_with_numbers(content), np.uint8), how) if content else None
    except cv2.error:
        picture = None
    if picture is None:
        raise SceneError(f"mask {path}: is damaged, or no picture; save it as PNG")
    if picture.shape != sensor_px[::-1]:
        height, width = picture.shape
        raise SceneError(
            f"mask {path}: is {width} x {height} px, and the camera {sensor_px[0]} x {sensor_px[1]}; draw it on"
            " one of its frames"
        )
    white = picture > picture.max() / 2.0
    if not white.any() or white.all():
        raise SceneError(
            f"mask {path}: leaves out {'all' if white.any() else 'nothing'}; white is what it leaves out"
        )
    return np.asarray(white, np.uint8)


def _with_numbers(content: bytes) -> bytes:
    """Return a TIFF without the word that its numbers are shown inverted: here they are labels, and no light."""
    order = {b"II": "<", b"MM": ">"}.get(content[:2])
    if order is None or len(content) < 16:
        return content
    (magic,) = struct.unpack_from(f"{order}H", content, 2)
    at, number, step, value_at = (8, "Q", 20, 12) if magic == BIG_TIFF else (4, "I", 12, 8)
    altered = bytearray(content)
    try:
        (start,) = struct.unpack_from(f"{order}{number}", content, at)
        (count,) = struct.unpack_from(f"{order}{'Q' if magic == BIG_TIFF else 'H'}", content, start)
        first = start + (8 if magic == BIG_TIFF else 2)
        for entry in range(first, first + step * min(count, 1000), step):
            tag, value = (
                struct.unpack_from(f"{order}H", content, place)[0] for place in (entry, entry + value_at)
            )
            if (tag, value) == (PHOTOMETRIC, MIN_IS_WHITE):
                struct.pack_into(f"{order}H", altered, entry + value_at, MIN_IS_BLACK)
    except struct.error:  # damaged, which the decoder says
        return content
    return bytes(altered)


def _simplify(contour: NDArray[Any]) -> NDArray[np.float64]:
    """Corners u, v (N, 2) of a contour around fine pixels, three at least."""
    import cv2

    few = cv2.approxPolyDP(contour, FINER * STRAIGHT_PX, closed=True)
    points = (few if len(few) >= 3 else contour)[:, 0]
    return np.asarray((points - 1.0 - (FINER - 1) / 2.0) / FINER)


def _join_hole(outline: NDArray[np.float64], hole: NDArray[np.float64]) -> NDArray[np.float64]:
    """One outline of an area and of a hole in it: along the cut there, around the hole, along the cut back."""
    return np.vstack((outline, outline[:1], hole, hole[:1]))
