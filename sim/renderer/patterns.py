"""Prints on the target: functions from a point of the printed page [mm] to reflectance 0..1.

A sheet has its own axes: x right and y up on the paper, origin where the scene has its world origin.  Its
``Pose`` puts it into the world, so a target that sits 0.2 mm beside its nominal place, or is moved by a
stage, is the same pattern with another pose:

    p = offset + Rz Ry Rx (x, y, 0)

All patterns are pure: the same point gives the same value, whatever was asked before.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.renderer.kernels.reflectance import (
    Bins,
    chessboard,
    dot_grid,
    draw_image,
    particles,
    plate,
    sharp_image,
)
from sim.renderer.kernels.staggered import dots_in_rows
from tracer.board import Board
from tracer.camera import Vector3
from tracer.errors import SceneError

Points = NDArray[np.float64]
MOST_SIDE_PX = 400  # of a square in the picture of a coded board
PRINT_REACH_SIGMAS = 5.0  # a Gaussian is 4e-6 of its peak there: below one count in 12 bit


@dataclass(frozen=True)
class Pose:
    """Place of a printed sheet: offset [mm] of its origin, then turns [rad] about the world's x, y, z."""

    offset_mm: Vector3 = (0.0, 0.0, 0.0)
    turn_rad: Vector3 = (0.0, 0.0, 0.0)

    def axes(self) -> Points:
        """Rows (4, 3): origin, x axis, y axis and normal of the sheet in world coordinates."""
        (ca, cb, cc), (sa, sb, sc) = np.cos(self.turn_rad), np.sin(self.turn_rad)
        about_x = np.array([[1.0, 0.0, 0.0], [0.0, ca, -sa], [0.0, sa, ca]])
        about_y = np.array([[cb, 0.0, sb], [0.0, 1.0, 0.0], [-sb, 0.0, cb]])
        about_z = np.array([[cc, -sc, 0.0], [sc, cc, 0.0], [0.0, 0.0, 1.0]])
        return np.vstack((self.offset_mm, (about_z @ about_y @ about_x).T))

    def to_world(self, points_mm: ArrayLike) -> Points:
        """World points (..., 3) of sheet points (..., 2) [mm]."""
        sheet = np.asarray(points_mm, dtype=np.float64)
        axes = self.axes()
        return np.asarray(axes[0] + sheet[..., :1] * axes[1] + sheet[..., 1:] * axes[2])

    def translate(self, x_mm: float = 0.0, y_mm: float = 0.0, z_mm: float = 0.0) -> "Pose":
        """Return the pose moved along the world's axes."""
        x, y, z = self.offset_mm
        return replace(self, offset_mm=(x + x_mm, y + y_mm, z + z_mm))


class Pattern(Protocol):
    """A printed sheet: its pose and its reflectance."""

    @property
    def pose(self) -> Pose:
        """Place of the sheet."""

    def reflectance(self, points_mm: Points) -> NDArray[np.float32]:
        """Reflectance (N,), 0 to 1, at points (N, 2) of the sheet [mm]."""


AnyPattern = TypeVar("AnyPattern", bound="Chessboard | CodedBoard | DotGrid | Plate | ParticleSheet | Image")


def place(pattern: AnyPattern, pose: Pose) -> AnyPattern:
    """Return the same print at another place."""
    return replace(pattern, pose=pose)


@dataclass(frozen=True)
class PrintedBoard(Board):
    """A `Board` in two shades, on paper as bright as its bright squares.

    Parameters
    ----------
    dark, bright : float
        Reflectance of the two shades.
    pose : Pose
        Place of the board.
    """

    dark: float = 0.08
    bright: float = 0.92
    pose: Pose = field(default_factory=Pose)

    def __post_init__(self) -> None:
        if not 0.0 <= self.dark <= self.bright <= 1.0:
            raise SceneError("the board's shades must be 0 <= dark <= bright <= 1")

    def ends(self) -> Points:
        """Lines (2, 2) of the lattice on which the board begins and ends."""
        if self.squares is None:
            return np.array([(-np.inf, -np.inf), (np.inf, np.inf)])
        middle = np.array(self.origin_corner or (self.squares[0] // 2, self.squares[1] // 2))
        return np.array((-middle, np.array(self.squares) - middle), np.float64)


@dataclass(frozen=True)
class Chessboard(PrintedBoard):
    """A chessboard in print."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.discs and not 0.0 <= self.disc_mm < self.square_mm:
            raise SceneError("the chessboard's discs must fit into its squares; lower disc_mm")

    def reflectance(self, points_mm: Points) -> NDArray[np.float32]:
        """Reflectance (N,) at points (N, 2) of the board [mm]."""
        out = np.empty(len(points_mm), np.float32)
        discs = np.array(self.discs, np.float64).reshape(-1, 2)
        drawn_mm = points_mm / np.array(self.scale)
        shades = np.array([self.dark, self.bright], np.float32)
        chessboard(drawn_mm, self.square_mm, 0.5 * self.disc_mm, discs, self.ends(), self.odd_bright, shades, out)
        return out


@dataclass(frozen=True)
class DotGrid(PrintedBoard):
    """A grid of dots in print."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.dots is None or not 0.0 < self.dots.dot_mm <= self.disc_mm < self.square_mm:
            raise SceneError("a grid of dots has dots, no larger than the large ones, and these than the pitch")

    def reflectance(self, points_mm: Points) -> NDArray[np.float32]:
        """Reflectance (N,) at points (N, 2) of the grid [mm]."""
        assert self.dots is not None
        out = np.empty(len(points_mm), np.float32)
        large = np.array(self.discs, np.float64).reshape(-1, 2)
        radii = 0.5 * np.array((self.dots.dot_mm, self.disc_mm))
        shades = (self.bright, self.dark) if self.dots.bright else (self.dark, self.bright)
        drawn_mm = points_mm / np.array(self.scale)
        if self.staggered:
            draw_staggered_rows(self, (drawn_mm, drawn_mm), (*shades, 0.0), out)
        else:
            dot_grid(drawn_mm, self.square_mm, radii, large, self.ends(), np.array(shades, np.float32), out)
        draw_other_marks(self, (drawn_mm, drawn_mm), shades, out)
        return out


@dataclass(frozen=True)
class Plate(PrintedBoard):
    """A machined plate: dots on its face, and on the ground of grooves that are cut into it.

    Parameters
    ----------
    wall : float
        Reflectance of the walls of the grooves.
    """

    wall: float = 0.03

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.dots is None or self.dots.levels not in GROOVES or self.dots.step_mm == 0.0:
            raise SceneError("a plate has dots on levels, and a step between these")
        if self.dots.marks != "large" and not self.staggered:
            raise SceneError("a plate with other marks than large dots has staggered rows")

    @property
    def face_mm(self) -> float:
        """Height of the face before the plane of the target, in which the origin is."""
        assert self.dots is not None
        return max(-self.dots.step_mm, 0.0)

    @property
    def ground_mm(self) -> float:
        """The same of the ground of the grooves; behind the plane it is negative."""
        assert self.dots is not None
        return min(-self.dots.step_mm, 0.0)

    def reflectance(self, points_mm: Points) -> NDArray[np.float32]:
        """Reflectance (N,) at points (N, 2) [mm] seen from straight above."""
        return self.shade(points_mm, points_mm)

    def shade(self, face_mm: Points, ground_mm: Points) -> NDArray[np.float32]:
        """Reflectance (N,) that rays meet which cross the face here, and its ground there, (N, 2) [mm] each."""
        assert self.dots is not None
        out = np.empty(len(face_mm), np.float32)
        large = np.array(self.discs, np.float64).reshape(-1, 2)
        sizes = np.array((self.square_mm, 0.5 * self.dots.dot_mm, 0.5 * self.disc_mm))
        dot, ground = (self.bright, self.dark) if self.dots.bright else (self.dark, self.bright)
        groove = np.array((*GROOVES[self.dots.levels], self.dots.step_mm < 0.0), np.int64)
        shades = np.array((dot, ground, self.wall), np.float32)
        drawn = face_mm / np.array(self.scale), ground_mm / np.array(self.scale)
        if self.staggered:
            draw_staggered_rows(self, drawn, (dot, ground, self.wall), out)
            draw_other_marks(self, drawn, (dot, ground), out)
        else:
            plate(drawn[0], drawn[1], sizes, large, self.ends(), groove, shades, out)
        return out


def draw_staggered_rows(
    board: PrintedBoard, levels: tuple[Points, Points], shades: tuple[float, ...], out: NDArray[np.float32]
) -> None:
    """Draw staggered rows where rays cross face and ground of the board as drawn, (N, 2) [mm] each."""
    assert board.dots is not None
    half = board.square_mm / np.sqrt(2.0)
    if max(board.dots.dot_mm, board.disc_mm) > half:
        raise SceneError("staggered dots are no wider than the distance of rows")
    discs = np.array(board.discs if board.dots.marks == "large" else ()).reshape(-1, 2)
    large = np.stack((discs[:, 0] - discs[:, 1], discs[:, 0] + discs[:, 1]), axis=-1).astype(np.float64)
    sizes = np.array((half, 0.5 * board.dots.dot_mm, 0.5 * board.disc_mm))
    groove = np.array((bool(board.dots.levels), board.dots.step_mm < 0.0), np.int64)
    dots_in_rows(*levels, sizes, large, board.ends(), groove, np.array(shades, np.float32), out)


def draw_other_marks(
    board: PrintedBoard, levels: tuple[Points, Points], shades: tuple[float, float], out: NDArray[np.float32]
) -> None:
    """Draw squares and a triangle between dots, or the ground over dots that are missing."""
    assert board.dots is not None
    between = 0.5 if board.dots.marks == "between" else 0.0
    radius = 0.5 * board.dots.dot_mm
    for i, j in board.discs if board.dots.marks != "large" else ():
        x, y = i + between, j + between
        if board.staggered:
            x, y = (x - y) / np.sqrt(2.0), (x + y) / np.sqrt(2.0)
        row = round(y * np.sqrt(2.0))
        is_deep = bool(board.dots.levels) and (row % 2 != 0) != (board.dots.step_mm < 0.0)
        dx, dy = (levels[int(is_deep)] - board.square_mm * np.array((x, y))).T
        if not between:
            out[np.hypot(dx, dy) < 1.05 * radius] = shades[1]
        elif (i, j) != board.dots.triangle:
            out[np.maximum(np.abs(dx), np.abs(dy)) < 0.9 * radius] = shades[0]
        else:  # a triangle that points up
            out[(dy > -0.8 * radius) & (dy + np.sqrt(3.0) * np.abs(dx) < 1.6 * radius)] = shades[0]


GROOVES = {"columns": (1, 0), "rows": (0, 1), "alternating": (1, 1), "staggered": (1, 1)}


@dataclass(frozen=True)
class CodedBoard(PrintedBoard):
    """A ChArUco board in print: the picture that OpenCV draws of it, with sharp edges."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.codes is None or self.squares is None:
            raise SceneError("a coded board has codes, and so many squares")

    def reflectance(self, points_mm: Points) -> NDArray[np.float32]:
        """Reflectance (N,) at points (N, 2) of the board [mm]."""
        out = np.empty(len(points_mm), np.float32)
        columns, rows = self.squares or (0, 0)
        middle = np.array(self.origin_corner or (columns // 2, rows // 2))
        squares = points_mm / (np.array(self.scale) * self.square_mm) + middle
        sharp_image(squares, self._picture, len(self._picture) // rows, self.dark, self.bright, out)
        return out

    @cached_property
    def _picture(self) -> NDArray[np.uint8]:
        """The board in whole pixels a cell, row 0 at the top."""
        import cv2

        assert self.codes is not None
        assert self.squares is not None
        names = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.codes.dictionary))
        cells, share = names.markerSize + 2, self.codes.marker_share
        for side in range(2 * cells, MOST_SIDE_PX):
            marker = side * share
            if (
                abs(marker - round(marker)) < 1e-6
                and round(marker) % cells == 0
                and (side - round(marker)) % 2 == 0
            ):
                break
        else:
            raise SceneError(
                "no picture has whole pixels a cell of such markers; take a rounder share of the square"
            )
        board = cv2.aruco.CharucoBoard(self.squares, 1.0, share, names)
        board.setLegacyPattern(self.codes.layout == "legacy")
        size = self.squares[0] * side, self.squares[1] * side
        return np.asarray(board.generateImage(size, marginSize=0, borderBits=1), dtype=np.uint8)


@dataclass(frozen=True, eq=False)
class ParticleSheet:
    """Printed particles: Gaussians of one width, their sum clipped at 1.

    Parameters
    ----------
    places_mm : ndarray
        Centres (N, 2) on the sheet.
    sigma_mm : float
        Width; the diameter at 1/e^2 is 4 sigma.
    peaks : float or ndarray
        Reflectance at the centre, one for all or (N,).
    background : float
        Reflectance of the paper.
    pose : Pose
        Place of the sheet.
    """

    places_mm: Points
    sigma_mm: float
    peaks: float | Points = 0.9
    background: float = 0.03
    pose: Pose = field(default_factory=Pose)

    def __post_init__(self) -> None:
        if self.places_mm.ndim != 2 or self.places_mm.shape[1] != 2 or not np.isfinite(self.places_mm).all():
            raise SceneError("particle places must be finite and of shape (N, 2)")
        if not self.sigma_mm > 0.0:
            raise SceneError("particles must have a positive sigma_mm")

    def displace(self, shift_mm: ArrayLike | Callable[[Points], Points]) -> "ParticleSheet":
        """Return the same particles, each moved on the sheet.

        Parameters
        ----------
        shift_mm : array_like or callable
            One shift (2,), one for each particle (N, 2), or a field: places (N, 2) -> shifts (N, 2).
        """
        shift = shift_mm(self.places_mm) if callable(shift_mm) else np.asarray(shift_mm, dtype=np.float64)
        return replace(self, places_mm=self.places_mm + shift)

    def reflectance(self, points_mm: Points) -> NDArray[np.float32]:
        """Reflectance (N,) at points (N, 2) of the sheet [mm]."""
        out = np.empty(len(points_mm), np.float32)
        particles(points_mm, self._bins, self.sigma_mm, self.background, out)
        return out

    @cached_property
    def _bins(self) -> Bins:
        """Particles sorted into square cells as wide as a particle reaches."""
        cell = PRINT_REACH_SIGMAS * self.sigma_mm
        places = np.ascontiguousarray(self.places_mm)
        peaks = np.broadcast_to(np.asarray(self.peaks, dtype=np.float64), places.shape[:1])
        if len(places) == 0:
            return Bins(places, peaks.copy(), np.zeros((1, 2), np.int64), np.zeros(2), cell)
        corner = places.min(axis=0)
        index = ((places - corner) / cell).astype(np.int64)
        columns, rows = (int(n) + 1 for n in index.max(axis=0))
        flat = index[:, 1] * columns + index[:, 0]
        order = np.argsort(flat, kind="stable")
        ends = np.concatenate(([0], np.cumsum(np.bincount(flat, minlength=rows * columns))))
        first = np.arange(rows)[:, None] * columns + np.arange(columns + 1)
        return Bins(places[order], peaks[order], ends[first].astype(np.int64), corner, cell)


def print_particles(
    size_mm: tuple[float, float],
    px_per_mm: float,
    *,
    seed: int,
    density_per_px: float = 0.02,
    diameter_px: float = 3.0,
    peak: float = 0.9,
    background: float = 0.03,
) -> ParticleSheet:
    """Return a sheet of particles at random places, described as a camera of a stated scale sees it.

    Parameters
    ----------
    size_mm : (float, float)
        Width and height of the printed area, centred on the origin.
    px_per_mm : float
        Scale at which density and diameter hold.
    seed : int
        The same seed gives the same sheet.
    density_per_px : float
        Particles per pixel.
    diameter_px : float
        Diameter at 1/e^2 (sigma = d/4).
    peak, background : float
        Reflectance of a particle's centre and of the paper.
    """
    size = np.array(size_mm)
    count = round(float(density_per_px * px_per_mm**2 * size.prod()))
    places = np.random.default_rng(seed).uniform(-0.5, 0.5, (count, 2)) * size
    return ParticleSheet(places, 0.25 * diameter_px / px_per_mm, peak, background)


@dataclass(frozen=True, eq=False)
class Image:
    """A picture printed on the sheet, bilinear between its pixels, exact at them.

    Parameters
    ----------
    values : ndarray
        Reflectance (rows, columns), 0 to 1; row 0 is at the top (+y).
    pixel_mm : float
        Edge of a printed pixel; the picture's centre lies on the sheet's origin.
    outside : float
        Reflectance of the paper around it.
    pose : Pose
        Place of the sheet.
    """

    values: NDArray[np.float32]
    pixel_mm: float
    outside: float = 0.0
    pose: Pose = field(default_factory=Pose)

    def __post_init__(self) -> None:
        if self.values.ndim != 2 or self.values.size == 0:
            raise SceneError("a printed image must have rows and columns")
        if not (self.values.min() >= 0.0 and self.values.max() <= 1.0):
            raise SceneError("a printed image's values are reflectances; scale them to 0..1")
        if not self.pixel_mm > 0.0:
            raise SceneError("a printed image must have a positive pixel_mm")

    def reflectance(self, points_mm: Points) -> NDArray[np.float32]:
        """Reflectance (N,) at points (N, 2) of the sheet [mm]."""
        out = np.empty(len(points_mm), np.float32)
        values = np.ascontiguousarray(self.values, dtype=np.float32)
        draw_image(points_mm, values, self.pixel_mm, self.outside, out)
        return out
