"""One estimate of what cameras share, from a fit of each: balls, walls, glass and print, not poses and lenses.

Near its solution each fit is a Gaussian: values f_k and a root R_k of their covariance, the prior included.  With
y the shared numbers in units of their prior sigma, (y_k, Y_k) those of camera k and P_k = diag(1/r^2) its prior
about m_k, its frames alone tell D_k = Y_k^-1 - P_k, and all frames together, with the prior counted once,

    L = P_1 + sum D_k,        y = L^-1 (sum Y_k^-1 y_k - P_k m_k).

The numbers of a camera follow by what its fit knows only together, G_k = cov(f_k, y_k) Y_k^-1:

    f_k + G_k (y - y_k),        root (G_k L^-1/2, R_k - G_k R_y,k).

The first columns are the same draws in all cameras, so that their maps err together; the others are independent.
This is a step of Gauss and Newton from the single fits, which differ by a few sigma at most where the test holds.
Where the frames are far from linear, or a number is held that is wrong, the common glass does not fit them any
more: residuals behind glass that grow by more than `MAX_GROWTH` refuse it.

**Test.**  What the other cameras and the prior expect of camera k, and what its frames tell, differ by

    z = y without k - D_k^+ (Y_k^-1 y_k - P_k m_k),        chi^2 = z^T (L without k^-1 + D_k^+)^-1 z

in the directions in which D_k exceeds the prior.  Of three cameras or more the one without which the others agree
is named.

Errors of the print that both cameras see count as independent.  The target stands still while all cameras look.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from correction.fit.adjustment import feasible_scene, root_of
from correction.fit.judge.result import FitStep, SceneFit
from correction.fit.solve.considered import ShapeRoot
from ground.plain_words import quantity
from tracer.bodies import Body, Sphere
from tracer.media import shifted
from tracer.scene.scene import Scene
from tracer.strategies.sensitivity import landings

OWN = ("camera.", "target")  # beginnings of names that no two cameras share
UNLIKE = 2.0  # residual in sigmas beyond which fits do not show one bench
MAX_GROWTH = 1.5  # of the rms residual of corners behind glass
SINGULAR = 1e-12
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Shared:
    """Shared numbers of one camera: y_k and its root, D_k, and the product of D_k with its estimate."""

    values: Floats
    root: Floats
    information: Floats
    vector: Floats

    @property
    def inverse(self) -> Floats:
        """Y^-1."""
        return np.asarray(np.linalg.inv(self.root @ self.root.T + SINGULAR * np.eye(len(self.root))))


@dataclass(frozen=True, eq=False)
class JointFit:
    """Fits of cameras that share what is not theirs.

    Parameters
    ----------
    fits : tuple of SceneFit
        Of each camera.
    names : tuple of str
        Shared numbers.
    sigmas, sigmas_alone : ndarray of float64, shape (P,), (cameras, P)
        Standard deviations of these, together and by each camera, in units of the prior's.
    residual_sigma : float
        By how much the cameras differ in what they share, in sigmas (rms).
    without : tuple of float
        The same without each camera, where there are three or more.
    growth : tuple of float
        Rms residual of the corners of each camera behind glass by the glass of all cameras, over that by its fit.
    """

    fits: tuple[SceneFit, ...]
    names: tuple[str, ...]
    sigmas: Floats
    sigmas_alone: Floats
    residual_sigma: float
    without: tuple[float, ...] = ()
    growth: tuple[float, ...] = ()

    @property
    def sentences(self) -> list[str]:
        """Agreement of the cameras, and what they gain, a line each."""
        count = quantity(len(self.names), "shared number")
        found = [f"the cameras differ by {self.residual_sigma:.2f} sigma (rms) in {count}"]
        if not self.warning:
            gain = np.median(self.sigmas_alone / self.sigmas, axis=1)
            each = ", ".join(f"{times:.1f} of camera {number}" for number, times in enumerate(gain, start=1))
            found.append(f"uncertainty of these alone over that together (median): {each}")
        return found

    @property
    def warning(self) -> str:
        """Sentence about cameras that contradict each other; "" if they do not."""
        if not self.residual_sigma > UNLIKE:
            worst = max(self.growth, default=1.0)
            if worst <= MAX_GROWTH:
                return ""
            camera = self.growth.index(worst) + 1
            return (
                f"by the glass of all cameras residuals of camera {camera} behind glass are {worst:.1f} times as"
                " large: a model is wrong, or too few corners show it; each keeps its own fit"
            )
        said = f"the cameras differ by {self.residual_sigma:.1f} sigma (rms) in what they share: the target or the"
        said += " glass stood elsewhere for one of them, or a model is wrong; each keeps its own fit"
        better = [number for number, left in enumerate(self.without, start=1) if left < UNLIKE]
        return f"{said}; without camera {better[0]} they agree" if len(better) == 1 else said


def join_fits(fits: Sequence[SceneFit]) -> JointFit:
    """Join the fits of two cameras or more of one bench, whose bodies have the same names.

    Cameras that contradict each other (`JointFit.warning`) keep their own fits.
    """
    first = fits[0].unknowns
    names = tuple(
        name for name in first.names if not name.startswith(OWN) and all(name in fit.names for fit in fits)
    )
    columns = first.columns[:, [first.names.index(name) for name in names]]
    rows = [name for name, row in zip(first.full_names, columns, strict=True) if row.any()]
    parts = [_tell(fit, first.start, columns, rows, names) for fit in fits]
    joint, precision = _combine(parts)
    alone = np.stack([np.sqrt(np.square(one.root).sum(axis=1)) for one in parts])
    together = np.sqrt(np.diag(np.linalg.inv(precision)))
    whole = _residual(parts)
    without = [_residual([*parts[:k], *parts[k + 1 :]]) for k in range(len(parts)) if len(parts) > 2]
    found = JointFit(tuple(fits), names, together, alone, whole, tuple(without))
    if found.warning:
        return found
    draws = root_of(np.asarray(np.linalg.inv(precision), np.float64))
    key = hashlib.sha256(np.ascontiguousarray(joint).tobytes()).hexdigest()[:16]
    moved = tuple(_move(fit, one, joint, draws, key) for fit, one in zip(fits, parts, strict=True))
    growth = tuple(_growth(fit, one) for fit, one in zip(fits, moved, strict=True))
    found = replace(found, growth=growth)
    return found if found.warning else replace(found, fits=moved)


def _tell(fit: SceneFit, start: Floats, columns: Floats, rows: list[str], names: tuple[str, ...]) -> _Shared:
    """Shared numbers of one fit about `start` in units of `columns`, both those of the first camera."""
    own, size = fit.unknowns, np.square(columns).sum(axis=0)
    here = [own.full_names.index(name) for name in rows]
    unit = columns[columns.any(axis=1)]
    middle = start[columns.any(axis=1)]
    values = (own.full(fit.x)[here] - middle) @ unit / size
    root = (unit.T @ fit.root[here]) / size[:, None]
    place = [own.names.index(name) for name in names]
    ratio = own.sigma[place] / np.abs(columns).max(axis=0)
    prior, centre = np.diag(ratio**-2.0), (own.start[here] - middle) @ unit / size
    inverse = np.linalg.inv(root @ root.T + SINGULAR * np.eye(len(root)))
    strength, axes = np.linalg.eigh(inverse - prior)
    axes, strength = axes[:, strength > 0.0], strength[strength > 0.0]  # a prior that was widened tells less
    vector = axes @ (axes.T @ (inverse @ values - prior @ centre))
    return _Shared(values, root, (axes * strength) @ axes.T, vector)


def _combine(parts: Sequence[_Shared]) -> tuple[Floats, Floats]:
    """Shared numbers and their precision by some cameras and the prior."""
    precision = np.eye(len(parts[0].values)) + sum(one.information for one in parts)
    vector = np.sum([one.vector for one in parts], axis=0)
    return np.asarray(np.linalg.solve(precision, vector), np.float64), precision


def _residual(parts: Sequence[_Shared]) -> float:
    """Difference of each camera from the others in sigmas, rms; NaN where nothing is shared."""
    chi2, freedom = 0.0, 0
    for k, one in enumerate(parts):
        expected, precision = _combine([*parts[:k], *parts[k + 1 :]])
        strength, axes = np.linalg.eigh(one.information)
        axes, strength = axes[:, strength > 1.0], strength[strength > 1.0]
        off = axes.T @ expected - (axes.T @ one.vector) / strength
        spread = axes.T @ np.linalg.inv(precision) @ axes + np.diag(1.0 / strength)
        chi2, freedom = chi2 + float(off @ np.linalg.solve(spread, off)), freedom + len(strength)
    return float(np.sqrt(chi2 / freedom)) if freedom else float("nan")


def _move(fit: SceneFit, part: _Shared, joint: Floats, draws: Floats, key: str) -> SceneFit:
    """The fit of a camera whose shared numbers are those of all cameras."""
    unknowns, whole = fit.unknowns, np.concatenate((fit.root, fit.shapes.root))
    gain = whole @ part.root.T @ part.inverse
    count = len(fit.root)
    full = unknowns.full(fit.x) + gain[:count] @ (joint - part.values)
    x = unknowns.free(full)
    root = np.column_stack((gain @ draws, whole - gain @ part.root))
    size = np.square(unknowns.columns).sum(axis=0)
    of_x = (unknowns.columns.T @ root[:count]) / size[:, None]
    scene, pushed = feasible_scene(unknowns, unknowns.full(x))
    return replace(
        fit,
        scene=scene,
        measured_scene=_in_its_light(fit, scene),
        x=x,
        covariance=of_x @ of_x.T,
        root=root[:count],
        shapes=ShapeRoot(fit.shapes.balls, root[count:]),
        pushed_mm=pushed,
        history=(*fit.history, FitStep("glass and print joined with the other cameras")),
        joint=(key, draws.shape[1]),
    )


def _growth(fit: SceneFit, moved: SceneFit) -> float:
    """Rms residual behind glass in the moved scene over that of the fit, or of all corners; at least 1."""
    corners = fit.corners
    used = corners.inlier & corners.behind
    before, after = (landings(one.scene, corners.pixel[used]) for one in (fit, moved))
    left = corners.residual_px[used] + before.step_px(after)  # the corner moves against what a pixel shows
    seen = np.isfinite(left).all(axis=1)
    if not seen.any():
        return 1.0
    # A few corners behind glass may be fitted exactly.
    own = max(float(np.square(corners.residual_px[some]).mean()) for some in (used, corners.inlier))
    return max(1.0, float(np.sqrt(np.square(left[seen]).mean() / own)))


def _in_its_light(fit: SceneFit, scene: Scene) -> Scene:
    """Return the joined scene with its glass as it is at the scene's wavelength, as `fit.measured_scene` is."""
    lit = {ball.name: ball.medium for ball in fit.scene.spheres}
    own = {ball.name: ball.medium for ball in fit.measured_scene.spheres}

    def with_medium(body: Body) -> Body:
        before, after = (media.get(body.name) for media in (lit, own))
        if not isinstance(body, Sphere) or body.medium is None or before is None or after is None:
            return body
        change = after.n(scene.wavelength_nm) - before.n(scene.wavelength_nm)
        return replace(body, medium=shifted(body.medium, change))

    return replace(scene, bodies=tuple(map(with_medium, scene.bodies)), masked=fit.measured_scene.masked)
