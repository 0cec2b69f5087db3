"""Computer-generated images: a pattern on the plane, and what the camera of a scene sees of it.

The pattern is a board with markers, the target, or particles.  The board with coloured markers along a diagonal is
that of Fig. 4 of Martins et al. (2018): behind a lens one sees at a glance which part of the plane is magnified,
turned over, or shown twice.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from correction.target import Chessboard
from ground.rows import run_rows
from rtpiv.analysis.pictures.kernels.patterns import add_markers, add_particles, add_target
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import RayMap, build_ray_map

COLOURS = ("#ffffff", "#d62728", "#1f77b4", "#e377c2", "#ffd92f", "#ff7f0e", "#7f7f7f", "#8c564b", "#2ca02c")
ROUND = np.array([1.0, 2.0, 2.5, 5.0, 10.0])  # lengths that people like, a decade of them
SQUARES = 64.0  # across the view, as in the paper
BRIGHT_SHARE = 0.25  # of the pixels of a target at least; particles cover less


class Pattern(Protocol):
    """Something on the plane."""

    channels: ClassVar[int]

    def add(self, plane_mm: NDArray[np.float64], picture: NDArray[np.float32]) -> None:
        """Add its colour at points (N, 2) [mm] to a picture (N, channels); NaN adds nothing."""


@dataclass(frozen=True)
class MarkerBoard:
    """A chessboard of `square_mm` with markers along the diagonal through the origin, in colours by turns."""

    square_mm: float
    channels: ClassVar[int] = 3

    def add(self, plane_mm: NDArray[np.float64], picture: NDArray[np.float32]) -> None:
        """As `Pattern`."""
        spacing, size = 1.2 * 2.0**0.5 * self.square_mm, 0.76 * self.square_mm
        add_markers(plane_mm, self.square_mm, spacing, size, _RGB, picture)


@dataclass(frozen=True)
class Target:
    """The target on the bench."""

    board: Chessboard
    channels: ClassVar[int] = 1

    def add(self, plane_mm: NDArray[np.float64], picture: NDArray[np.float32]) -> None:
        """As `Pattern`."""
        board, lines = self.board, self.board.outer_lines
        if board.dots is not None:
            picture[:, 0] += board.shade(plane_mm)
            return
        middles = np.array(board.discs, dtype=np.float64).reshape(-1, 2) + 0.5
        discs = np.column_stack((middles, np.full(len(middles), board.disc_mm / board.square_mm)))
        ends = np.array([(-np.inf, -np.inf), (np.inf, np.inf)]) if lines is None else lines.astype(np.float64)
        shown = np.zeros((len(plane_mm), 1), np.float32)
        add_target(plane_mm, board.sides_mm, discs, ends, board.odd_bright, shown)
        if board.codes is not None:
            from correction.target.codes import marker_cells

            lit = np.flatnonzero(shown[:, 0])
            shown[lit[marker_cells(board, plane_mm[lit] / board.sides_mm)]] = 0.0
        picture += shown


@dataclass(frozen=True)
class Particles:
    """Particles of `diameter_mm`, one at a random place in each square of `cell_mm`; not those of any frame."""

    cell_mm: float
    diameter_mm: float
    channels: ClassVar[int] = 1

    def add(self, plane_mm: NDArray[np.float64], picture: NDArray[np.float32]) -> None:
        """As `Pattern`."""
        add_particles(plane_mm, self.cell_mm, self.diameter_mm, np.empty((9, 3)), picture)


def square_for(width_mm: float) -> float:
    """Side of the squares of a board that fills a view of some width [mm]: a round length, some 64 of them."""
    wanted = width_mm / SQUARES
    decade = 10.0 ** np.floor(np.log10(wanted))
    return float(decade * ROUND[np.argmin(np.abs(np.log(ROUND * decade / wanted)))])


def shows_particles(frame: NDArray[Any]) -> bool:
    """Return whether a frame (H, W) shows particles (few pixels brighter than half way), not a target."""
    some = frame[:: max(1, frame.shape[0] // 512), :: max(1, frame.shape[1] // 512)]
    low, high = np.percentile(some, (1.0, 99.0))
    return bool(np.mean(some > 0.5 * (low + high)) < BRIGHT_SHARE)


def _rgb(colour: str) -> tuple[float, float, float]:
    return (int(colour[1:3], 16) / 255.0, int(colour[3:5], 16) / 255.0, int(colour[5:7], 16) / 255.0)


_RGB = np.array([_rgb(colour) for colour in COLOURS])


WIDEST_PX = 1008  # of a picture: as large as it is drawn
Watched = Callable[[Iterable[tuple[float, float]], int, str], Iterable[tuple[float, float]]]


def pattern_view(
    scene: Scene, pattern: Pattern, samples: int = 3, watched: Watched = lambda items, total, what: items
) -> NDArray[np.float32]:
    """Image of a pattern on the plane through the scene's glass, refracted light only.

    Parameters
    ----------
    scene : Scene
        The scene.
    pattern : Pattern
        Object in the plane.
    samples : int
        Rays a pixel along each side.
    watched : callable
        Passes items on and says how far they are, see `ground.terminal.progress`.

    Returns
    -------
    ndarray of float32 (H, W), or (H, W, 3) of a pattern in colour
        Mean of the pattern over each pixel; 0 where no ray reaches the plane.
    """
    camera, (height, width) = scene.camera, scene.camera.shape
    total = np.zeros((height, width, pattern.channels), np.float32)
    offsets = ((np.arange(samples) + 0.5) / samples - 0.5).tolist()
    places = [(du, dv) for dv in offsets for du in offsets]
    ray_map: RayMap | None = None
    for du, dv in watched(places, len(places), "what the camera sees"):
        principal = (camera.principal_px[0] - du, camera.principal_px[1] - dv)
        moved = scene.with_camera(replace(camera, principal_px=principal))
        ray_map = build_ray_map(moved, ray_map)
        plane = np.asarray(ray_map.plane_mm, np.float64)

        def work(first: int, last: int, plane: NDArray[np.float64] = plane) -> None:
            pattern.add(plane[first:last].reshape(-1, 2), total[first:last].reshape(-1, pattern.channels))

        run_rows(work, height)
    total /= samples**2
    return total if pattern.channels > 1 else total[..., 0]
