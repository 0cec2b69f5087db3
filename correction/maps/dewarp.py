"""Dewarp: the polynomial between the ideal pinhole image and the acquired one.

A bare target shows where the lens and the camera's true pose put points whose ideal pixel (nominal pinhole)
is known.  With x, y the ideal pixel relative to `centre_px` in units of `scale_px`,

    acquired u = centre_u + scale sum_kl a_kl x^k y^l,      k + l <= order,       v likewise with b_kl.

Order 2 is the classical choice; it holds offset, scale, rotation, shear and the keystone of a tilt.  Order 3
also holds radial distortion, whose displacement grows with r^3; the r^5 that appears when a strong
distortion is inverted needs order 5.  The direction is ideal -> acquired, because a
corrected frame asks for the acquired pixel of each ideal one; nothing is inverted afterwards.

The coefficients come from least squares weighted by the sigma of each corner, in normalised coordinates:
the condition number of the matrix, reported, is then 4 to 150 for a full frame instead of 1e7 to 1e14 in pixels.

A polynomial says nothing outside its points.  Coverage is the part of the frame within the hull of the
points, each widened by half its spacing (the corner speaks for its surroundings); below 95 % the fit is
refused.
"""

from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from correction.errors import DewarpError
from correction.target import Chessboard
from correction.target.board_search import track_board
from correction.target.lattice_fit import BoardDetection
from ground.short_repr import short_repr
from piv.errors import FrameError
from tracer.camera import Camera

ORDERS = (2, 3, 4, 5)
LEAST_COVERAGE = 0.95
GROSS = 6.0  # pairs further off than this many robust sigmas are taken out
JUDGE_ORDER = 7  # of the polynomial against which gross errors are seen
PROBES = 101  # frame points a side on which the coverage is counted


@short_repr
@dataclass(frozen=True)
class Dewarp:
    """Ideal pinhole pixel -> acquired pixel.

    Parameters
    ----------
    order : int
        2, 3, 4 or 5.
    centre_px : (float, float)
        Ideal pixel taken as the origin.
    scale_px : float
        Ideal pixels per unit.
    coefficients : tuple of (float, float)
        For each power (k, l) in the order of `powers`: acquired u and v, in units of scale_px from centre_px.
    residual_rms_px, residual_max_px : float
        Of the fit, per coordinate, over the pairs used.
    condition : float
        Condition number of the weighted least-squares matrix.
    coverage : float
        Part of the frame between the points of the fit, 0..1.
    used, left_out : int
        Pairs used and pairs taken out as gross errors.
    """

    order: int
    centre_px: tuple[float, float]
    scale_px: float
    coefficients: tuple[tuple[float, float], ...]
    residual_rms_px: float
    residual_max_px: float
    condition: float
    coverage: float
    used: int
    left_out: int

    def __post_init__(self) -> None:
        if self.order not in ORDERS:
            raise DewarpError(f"the order of a dewarp is 2, 3, 4 or 5, not {self.order}")
        if len(self.coefficients) != len(powers(self.order)) or any(len(pair) != 2 for pair in self.coefficients):
            raise DewarpError(
                f"a dewarp of order {self.order} has {len(powers(self.order))} pairs of coefficients"
            )
        if not self.scale_px > 0.0 or not np.isfinite((*self.centre_px, *np.ravel(self.coefficients))).all():
            raise DewarpError("the numbers of a dewarp must be finite and its scale positive")

    def apply(self, ideal_px: ArrayLike) -> NDArray[np.float64]:
        """Acquired pixels (..., 2) of ideal pixels (..., 2); NaN stays NaN."""
        x, y = self._normalise(ideal_px)
        u, v = np.zeros_like(x), np.zeros_like(x)
        for (k, m), (a, b) in zip(powers(self.order), self.coefficients, strict=True):
            term = x**k * y**m
            u += a * term
            v += b * term
        return np.asarray(np.stack((u, v), axis=-1) * self.scale_px + np.array(self.centre_px))

    def jacobian(self, ideal_px: ArrayLike) -> NDArray[np.float64]:
        """Derivatives (..., 2, 2): row u, v acquired by column u, v ideal."""
        x, y = self._normalise(ideal_px)
        out = np.zeros((*x.shape, 2, 2))
        for (k, m), pair in zip(powers(self.order), self.coefficients, strict=True):
            by_x = k * x ** max(k - 1, 0) * y**m
            by_y = m * x**k * y ** max(m - 1, 0)
            for row in range(2):
                out[..., row, 0] += pair[row] * by_x
                out[..., row, 1] += pair[row] * by_y
        return out

    def largest_shift_px(self, sensor_px: tuple[int, int]) -> float:
        """Bound on ``|acquired - ideal|`` of u or v over a sensor of this width and height [px].

        Sum of the absolute values of all terms of the difference, each at the sensor's far edge.
        """
        reach = [
            max(abs(centre), abs(size - 1.0 - centre)) / self.scale_px
            for centre, size in zip(self.centre_px, sensor_px, strict=True)
        ]
        largest = np.zeros(2)
        for (k, m), pair in zip(powers(self.order), self.coefficients, strict=True):
            same = ((k, m) == (1, 0), (k, m) == (0, 1))  # u = x and v = y move nothing
            largest += np.abs(np.subtract(pair, same)) * reach[0] ** k * reach[1] ** m
        return float(largest.max() * self.scale_px)

    def summary(self) -> str:
        """One line for people."""
        left = f", {self.left_out} left out" if self.left_out else ""
        return (
            f"order {self.order}, {self.used} corners{left}, residual {self.residual_rms_px:.3f} px rms"
            f" ({self.residual_max_px:.2f} max), coverage {100 * self.coverage:.1f} %,"
            f" condition {self.condition:.1f}"
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, lists and text for YAML or JSON."""
        return {
            "order": self.order,
            "centre_px": list(self.centre_px),
            "scale_px": self.scale_px,
            "coefficients": [list(pair) for pair in self.coefficients],
            "residual_rms_px": self.residual_rms_px,
            "residual_max_px": self.residual_max_px,
            "condition": self.condition,
            "coverage": self.coverage,
            "used": self.used,
            "left_out": self.left_out,
        }

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> "Dewarp":
        """Dewarp from what `to_dict` gave.

        Raises
        ------
        DewarpError
            A key is missing or unknown, or a value is not a number of the right kind.
        """
        names = set(cls.__dataclass_fields__)
        if not isinstance(data, dict) or set(data) != names:
            raise DewarpError(f"a dewarp is a mapping with exactly these keys: {', '.join(sorted(names))}")
        try:
            u, v = (float(x) for x in data["centre_px"])
            pairs = tuple((float(a), float(b)) for a, b in data["coefficients"])
            rest = {name: float(data[name]) for name in names - {"centre_px", "coefficients"} - _WHOLE}
            whole = {name: int(data[name]) for name in _WHOLE}
        except (TypeError, ValueError) as error:
            raise DewarpError(f"a number of the dewarp cannot be read ({error}); fit it again") from error
        return cls(centre_px=(u, v), coefficients=pairs, **whole, **rest)  # type: ignore[arg-type]

    def _normalise(self, ideal_px: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        xy = (np.asarray(ideal_px, dtype=np.float64) - np.array(self.centre_px)) / self.scale_px
        return xy[..., 0], xy[..., 1]


_WHOLE = {"order", "used", "left_out"}


def powers(order: int) -> tuple[tuple[int, int], ...]:
    """Powers (k, l) of x, y of a full polynomial, in the order of the coefficients."""
    return tuple((total - m, m) for total in range(order + 1) for m in range(total + 1))


def fit_dewarp(image: NDArray[Any], camera: Camera, board: Chessboard, order: int = 2) -> Dewarp:
    """Fit the dewarp to a frame of the bare target at z = 0.

    Parameters
    ----------
    image : (H, W) uint8, uint16 or float
        The frame.
    camera : Camera
        The nominal camera; its lens terms are not used, they are what the dewarp replaces.
    board : Chessboard
        The target.
    order : int
        2, 3, 4 or 5.

    Raises
    ------
    FrameError
        Not a frame, or not of the camera's size.
    TargetNotFound
        See `correction.target.board_search`.
    DewarpError
        The corners do not determine the polynomial or cover too little of the frame.
    """
    if np.shape(image) != camera.shape:
        size = " x ".join(map(str, np.shape(image)[::-1]))
        raise FrameError(
            f"the target frame is {size} px, the camera {camera.sensor_px[0]} x {camera.sensor_px[1]};"
            " give a frame of this camera"
        )
    found = track_board(image, board, camera.project)
    return fit_dewarp_pairs(
        camera.project_ideal(board.place_mm(found.index)),
        found.position_px,
        camera.sensor_px,
        order,
        found.sigma_px,
        _spacing(found),
    )


def fit_dewarp_pairs(
    ideal_px: ArrayLike,
    acquired_px: ArrayLike,
    sensor_px: tuple[int, int],
    order: int = 2,
    sigma_px: ArrayLike | None = None,
    spacing_px: float = 0.0,
) -> Dewarp:
    """Fit the dewarp to pairs of points.

    Parameters
    ----------
    ideal_px, acquired_px : (N, 2) float
        The same points on the ideal and on the acquired image.
    sensor_px : (int, int)
        Width and height of the frame that must be covered.
    order : int
        2, 3, 4 or 5.
    sigma_px : (N, 2) float, optional
        Standard deviations of the acquired points; default all alike.
    spacing_px : float
        Distance of neighbouring points, for the coverage.

    Raises
    ------
    DewarpError
        Too few points, points on a line, or coverage below 95 %.
    """
    if order not in ORDERS:
        raise DewarpError(f"the order of a dewarp is 2, 3, 4 or 5, not {order}")
    ideal, acquired = np.asarray(ideal_px, dtype=np.float64), np.asarray(acquired_px, dtype=np.float64)
    need = 2 * len(powers(order))
    if ideal.shape != acquired.shape or ideal.ndim != 2 or len(ideal) < need:
        raise DewarpError(f"a dewarp of order {order} needs at least {need} pairs of points, got {len(ideal)}")
    covered = coverage(acquired, sensor_px, spacing_px)
    if covered < LEAST_COVERAGE:
        raise DewarpError(
            f"the target's corners cover {100 * covered:.1f} % of the frame and {100 * LEAST_COVERAGE:.0f} % are"
            " needed; use a target that fills the frame and light it to the edges"
        )
    size = np.array(sensor_px, dtype=np.float64)
    centre, scale = (size - 1.0) / 2.0, float(size.max()) / 2.0
    x, y = ((ideal - centre) / scale).T
    terms = np.stack([x**k * y**m for k, m in powers(order)], axis=-1)
    wanted = (acquired - centre) / scale
    sigma = np.ones_like(acquired) if sigma_px is None else np.asarray(sigma_px, dtype=np.float64)
    weight = 1.0 / np.maximum(sigma, 0.3 * np.median(sigma))  # no corner is ten times as good as the others
    keep = _sound(x, y, wanted, weight)
    solution = _fit_weighted(terms[keep], wanted[keep], weight[keep])
    miss = (wanted - terms @ solution) * scale
    condition = float(np.linalg.cond(terms[keep] * weight[keep].mean(axis=1, keepdims=True)))
    if not condition < 1e6:
        raise DewarpError(
            "the points lie on a line or a few spots and do not determine the dewarp;"
            " use corners all over the frame"
        )
    return Dewarp(
        order=order,
        centre_px=(float(centre[0]), float(centre[1])),
        scale_px=scale,
        coefficients=tuple((float(a), float(b)) for a, b in solution),
        residual_rms_px=sqrt(float(np.mean(miss[keep] ** 2))),
        residual_max_px=float(np.abs(miss[keep]).max()),
        condition=condition,
        coverage=covered,
        used=int(np.count_nonzero(keep)),
        left_out=int(np.count_nonzero(~keep)),
    )


def coverage(points_px: NDArray[np.float64], sensor_px: tuple[int, int], spacing_px: float = 0.0) -> float:
    """Part (0..1) of a frame inside the hull of points (N, 2), each widened to a square of side `spacing_px`."""
    half = 0.5 * spacing_px
    corners = half * np.array([(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)])
    try:
        hull = scipy.spatial.ConvexHull((points_px[:, None] + corners).reshape(-1, 2))
    except scipy.spatial.QhullError:
        return 0.0
    width, height = sensor_px
    u, v = np.meshgrid(np.linspace(0.0, width - 1.0, PROBES), np.linspace(0.0, height - 1.0, PROBES))
    probes = np.stack((u.ravel(), v.ravel()), axis=-1)
    inside = (probes @ hull.equations[:, :2].T + hull.equations[:, 2] <= 1e-9).all(axis=1)
    return float(inside.mean())


def _fit_weighted(
    terms: NDArray[np.float64], wanted: NDArray[np.float64], weight: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Least squares for u and v (N, 2), each with its own weights; coefficients (P, 2)."""
    columns = [
        np.linalg.lstsq(terms * weight[:, k : k + 1], wanted[:, k] * weight[:, k], rcond=None)[0] for k in range(2)
    ]
    return np.stack(columns, axis=-1)


def _sound(
    x: NDArray[np.float64], y: NDArray[np.float64], wanted: NDArray[np.float64], weight: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Pairs (N,) that are no gross errors.

    Judged against a polynomial of high order: what the wanted order cannot follow is no error of the pairs.
    """
    keep = np.ones(len(x), dtype=bool)
    fitting = [order for order in range(2, JUDGE_ORDER + 1) if 3 * len(powers(order)) <= len(x)]
    terms = np.stack([x**k * y**m for k, m in powers(max(fitting, default=2))], axis=-1)
    for _ in range(10):
        miss = np.abs(wanted - terms @ _fit_weighted(terms[keep], wanted[keep], weight[keep]))
        limit = max(GROSS * 1.4826 * float(np.median(miss[keep])), 1e-9)
        now = np.asarray((miss <= limit).all(axis=1), dtype=bool)
        if np.count_nonzero(now) < terms.shape[1] or np.array_equal(now, keep):
            break
        keep = now
    return keep


def _spacing(found: BoardDetection) -> float:
    """Median side of a square in the image [px]."""
    return float(np.median(np.hypot(found.axes_px[:, 0], found.axes_px[:, 1])))
