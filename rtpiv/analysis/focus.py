"""A focus scan evaluated: the best place of each part of the view, and the aperture that covers them all.

Blur adds to a spot's own size like variances, and grows with the distance from the best place,

    s^2(z) = s_0^2 + b (z - z_0)^2,

a parabola, with s counted on the plane: as the camera goes back everything shrinks.  It is fitted to the places
around the smallest s where s^2 is at most `WIDEST` times the smallest.  z_0 is the best place, and its standard
deviation comes from the scatter about the parabola.

The depth that the scene needs is the distance between its first and its last best place.  Eq. 1 of the paper turns
it into an f-number, and the planned f-number into a depth (`tracer.pupil`).

**How wide the images of particles are.**  The autocorrelation of many small spots is that of one spot, however
they overlap: for Gaussians of standard deviation s it falls with the lag l like  exp(-l^2 / (4 s^2)),  so

    s^2 = -l^2 / (4 ln rho(l)),     diameter = 4 s   (e^-2)

from the ratio rho of the covariance at lag l to that at no lag.  Covariances are taken between two frames of one
place, whose noise differs: only what both show counts.  Shapes that are not Gaussian change the scale of s and not
where it is smallest.

Parts differ by what the line of sight meets: beside all glass, and rings behind each stack of balls.  A
pixel belongs behind those balls that its straight line of sight crosses; its radius is that of the ball nearest
the camera, r = distance of the line from the centre / R.  Parts that are cut by a silhouette are left out, and a
band around every ball as well: a wide pupil sees both sides of an edge.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from daq.bench.bench_table import BenchTable
from daq.bench.elements import CAMERA, TARGET
from daq.errors import RunDamaged, RunUnsuitable
from daq.plans.experiments.focus import FocusPlan
from daq.runs.acquired import read_acquired
from daq.runs.records import CURE
from daq.runs.run_folder import RunFolder, frame_entries
from daq.runs.run_views import load_kept
from ground.config import load_yaml, read
from ground.short_repr import short_repr
from tracer.pupil import depth_of_field_mm, f_number_for_depth
from tracer.scene.scene import Scene
from tracer.scene.scene_file import load_scene

Float64 = NDArray[np.float64]

LAG_PX = 2
FOCUS_LEVEL_PX = 65  # light that varies slower than this is not detail
FEWEST_PX = 400  # below, a part says nothing
WIDEST = 2.5  # of the smallest s^2: farther off blur grows more slowly than the parabola says
SUREST = 0.02  # of s^2: few places may lie on a parabola by chance
FAINT = 0.15  # of the highest contrast: twice as wide spots have a quarter of it
FLAT = 0.12  # of the smallest s^2: a smaller change along a scan is chance, or that of the scale
MIN_FOCUS_PLACES = 4  # places that a parabola and its uncertainty are taken from


class Spots(NamedTuple):
    """Spots of a part: mean of s^2 over rows and columns, and their contrast, the variance of the light."""

    variance_px2: float
    contrast: float


NO_SPOTS = Spots(float("nan"), 0.0)


def spots_in(first: NDArray[np.generic], second: NDArray[np.generic], part: NDArray[np.bool_]) -> Spots:
    """Spots in a part (H, W) of two frames of one place; NaN and 0 if it shows none."""
    a, b = (_detail(frame, part) for frame in (first, second))
    whole = _covariance(a, b, part, 0, 0)
    if not whole > 0.0:
        return NO_SPOTS
    ratios = [
        0.5 * (_covariance(a, b, part, rows, columns) + _covariance(b, a, part, rows, columns)) / whole
        for rows, columns in ((LAG_PX, 0), (0, LAG_PX))
    ]
    if not all(0.0 < ratio < 1.0 for ratio in ratios):
        return NO_SPOTS
    return Spots(float(np.mean([-(LAG_PX**2) / (4.0 * np.log(ratio)) for ratio in ratios])), whole)


def _detail(frame: NDArray[np.generic], part: NDArray[np.bool_]) -> Float64:
    """Difference from the mean light around, which is taken within the part alone."""
    inside = part.astype(np.float64)
    values = np.where(part, frame.astype(np.float64), 0.0)
    share = scipy.ndimage.uniform_filter(inside, FOCUS_LEVEL_PX, mode="constant")
    level = scipy.ndimage.uniform_filter(values, FOCUS_LEVEL_PX, mode="constant") / np.maximum(share, 1e-9)
    return np.asarray(np.where(part, values - level, 0.0))


def _covariance(a: Float64, b: Float64, part: NDArray[np.bool_], rows: int, columns: int) -> float:
    """Mean product of a and b shifted by a lag, where both lie in the part."""
    height, width = part.shape
    here, there = np.s_[: height - rows, : width - columns], np.s_[rows:, columns:]
    both = part[here] & part[there]
    count = int(np.count_nonzero(both))
    if count < FEWEST_PX:
        return float("nan")
    return float(np.sum(a[here] * b[there] * both) / count)


RINGS = {"centre": (0.0, 0.2), "halfway": (0.35, 0.55), "rim": (0.6, 0.75)}
BESIDE_FROM = 1.45  # radii


def parts_of(scene: Scene) -> dict[str, NDArray[np.bool_]]:
    """Masks (H, W) by name: ``beside``, and ``BALLS: centre``, ``halfway`` and ``rim`` for each stack of balls."""
    camera = scene.camera
    rows, columns = np.indices(camera.shape)
    rays = camera.directions(np.stack((columns, rows), axis=-1))
    balls = sorted(scene.spheres, key=lambda s: -s.centre_mm[2])
    beside = np.ones(camera.shape, np.bool_)
    radii = []
    for ball in balls:
        to = np.subtract(ball.centre_mm, camera.position_mm)
        off = np.linalg.norm(np.cross(rays, to), axis=-1) / ball.radius_mm
        radii.append(off)
        beside &= off > BESIDE_FROM
    parts = {"beside": beside}
    crossed = np.zeros(camera.shape, np.int64)
    for bit, off in enumerate(radii):
        crossed |= (off < 1.0).astype(np.int64) << bit
    for stack in np.unique(crossed):
        members = [k for k in range(len(balls)) if stack >> k & 1]
        if not members:
            continue
        name = "+".join(balls[k].name for k in members)
        for ring, (low, high) in RINGS.items():
            off = radii[members[0]]
            parts[f"{name}: {ring}"] = (crossed == stack) & (off >= low) & (off < high)
    return {name: part for name, part in parts.items() if np.count_nonzero(part) >= FEWEST_PX}


@dataclass(frozen=True)
class BestFocus:
    """Best focus of a part of the view.

    Parameters
    ----------
    part : str
        Which part.
    z_mm, sigma_mm : float
        Best place and its standard deviation; NaN if the scan does not hold it.
    diameter_px : float
        Of a spot there (e^-2).
    why : str
        Why there is none; empty if there is.
    """

    part: str
    z_mm: float
    sigma_mm: float
    diameter_px: float
    why: str = ""


@short_repr
@dataclass(frozen=True)
class FocusScan:
    """Result of a scan.

    Parameters
    ----------
    moves : str
        What travelled: ``camera`` or ``target``.
    z_mm : ndarray
        Measured places (N,), ascending.
    variance_px2 : dict of str to ndarray
        s^2 (N,) of each part in pixels of the scene's own place; NaN where it shows no spots.
    best : tuple of BestFocus
        Of every part.
    magnification, f_number, wavelength_nm : float
        Of the measurement that is planned.
    """

    moves: str
    z_mm: Float64
    variance_px2: dict[str, Float64]
    best: tuple[BestFocus, ...]
    magnification: float
    f_number: float
    wavelength_nm: float

    @property
    def needed_mm(self) -> float:
        """Depth between the first and the last best place; NaN below two."""
        found = [each.z_mm for each in self.best if not each.why]
        return max(found) - min(found) if len(found) > 1 else float("nan")

    @property
    def needed_sigma_mm(self) -> float:
        """Its standard deviation."""
        found = sorted((each.z_mm, each.sigma_mm) for each in self.best if not each.why)
        return float(np.hypot(found[0][1], found[-1][1])) if len(found) > 1 else float("nan")

    @property
    def depth_mm(self) -> float:
        """Depth of field at the planned f-number."""
        return depth_of_field_mm(self.magnification, self.f_number, self.wavelength_nm)

    @property
    def needed_f_number(self) -> float:
        """F-number whose depth of field is what the scene needs; NaN if that is not known."""
        if not self.needed_mm > 0.0:
            return float("nan")
        return f_number_for_depth(self.needed_mm, self.magnification, self.wavelength_nm)


def spot_variances_px2(places: Sequence[Spots]) -> Float64:
    """s^2 (N,) where spots have some contrast; NaN where they are so faint that fine grain outweighs them."""
    least = FAINT * max((spots.contrast for spots in places), default=0.0)
    return np.array([spots.variance_px2 if spots.contrast > least else np.nan for spots in places])


def best_focus(part: str, z_mm: Float64, variance_px2: Float64) -> BestFocus:
    """Vertex of the parabola through the places around the sharpest one."""

    def none(why: str) -> BestFocus:
        return BestFocus(part, np.nan, np.nan, np.nan, why)

    known = np.isfinite(variance_px2)
    if np.count_nonzero(known) < MIN_FOCUS_PLACES:
        return none("too few places show spots")
    z, s2 = z_mm[known], variance_px2[known]
    if np.ptp(s2) < FLAT * s2.min():
        same = f"{50.0 * np.ptp(s2) / s2.min():.0f} % of its width"
        return none(f"it is as sharp everywhere, to {same}: open the lens, or take places farther apart")
    least = int(np.argmin(s2))
    if least in (0, len(z) - 1):
        return none(f"it is sharpest at {z[least]:+.1f} mm, the end of where it shows; add places")
    near = s2 <= WIDEST * s2[least]
    if not (near[least - 1] and near[least + 1]):
        return none(f"it is sharpest near {z[least]:+.1f} mm, where places are too far apart; add some around")
    first, last = least, least  # one run of places about the sharpest
    while first > 0 and near[first - 1]:
        first -= 1
    while last < len(z) - 1 and near[last + 1]:
        last += 1
    if last - first + 1 < MIN_FOCUS_PLACES:
        return none(
            f"only {last - first + 1} places around {z[least]:+.1f} mm are nearly as sharp; add some around"
        )
    z, s2 = z[first : last + 1], s2[first : last + 1]
    middle = z.mean()
    design = np.vander(z - middle, 3)
    weights = 1.0 / s2  # a width is known to a share of itself
    (a, b, c), *_ = np.linalg.lstsq(design * weights[:, None], s2 * weights, rcond=None)
    if not a > 0.0:
        return none("its sharpness has no peak")
    vertex = -b / (2.0 * a)
    if not z[0] <= middle + vertex <= z[-1]:
        return none("its sharpness has no peak among these places; go on")
    scatter = (design @ (a, b, c) - s2) * weights
    freedom = max(len(z) - 3, 1)
    inverse = np.linalg.inv((design * weights[:, None]).T @ (design * weights[:, None]))
    slope = np.array([b / (2.0 * a * a), -1.0 / (2.0 * a), 0.0])
    sigma = float(np.sqrt(slope @ inverse @ slope * max(scatter @ scatter / freedom, SUREST**2)))
    smallest = max(c - b * b / (4.0 * a), 0.0)
    return BestFocus(part, float(middle + vertex), sigma, float(4.0 * np.sqrt(smallest)))


def focus_scan(run: Path) -> FocusScan:
    """Evaluate the run of a focus plan.

    Raises
    ------
    RunUnsuitable
        The run is no focus scan, or is not far enough.
    RunDamaged
        What it says is not what was written.
    """
    folder = RunFolder.open(run)
    about, entries = folder.about, frame_entries(folder.entries())
    document = load_kept(folder, "plan", load_yaml)
    if not isinstance(document.tree, dict) or document.tree.get("experiment") != "focus":
        raise RunUnsuitable("is no focus scan", place=run, cure="take one with a plan of experiment: focus")
    plan = load_kept(folder, "plan", lambda file: read(file, FocusPlan))
    table = load_kept(folder, "bench", lambda file: read(file, BenchTable))
    scene: Scene = load_kept(folder, "scene", load_scene)
    if plan.view == "clear":
        scene = scene.bare()
    places: list[float] = []
    found: list[dict[str, Spots]] = []
    for step in about["steps"]:
        numbers = [n for n in range(step["first_frame"], step["first_frame"] + step["frames"]) if n in entries]
        if not numbers:
            continue
        try:
            camera_mm, target_mm = (
                table.offset_mm(element, entries[numbers[0]]["measured_mm"]) for element in (CAMERA, TARGET)
            )
        except KeyError as error:
            raise RunDamaged(f"frame {numbers[0]} lacks the position of {error}", place=run, cure=CURE) from None
        x, y, z = (float(c) for c in np.add(scene.camera.position_mm, camera_mm))
        stood = scene.with_camera(replace(scene.camera, position_mm=(x, y, z)))
        shown = [read_acquired(folder.inside(entries[n]["file"]), scene.camera.shape) for n in numbers[:2]]
        parts = parts_of(stood)
        places.append(camera_mm[2] if plan.moves == "camera" else target_mm[2])
        # Spots look larger from nearer: their widths are those seen from the place of the scene.
        further = (z - target_mm[2]) / scene.camera.position_mm[2]
        found.append(
            {
                name: spots._replace(variance_px2=further**2 * spots.variance_px2)
                for name, part in parts.items()
                for spots in [spots_in(shown[0], shown[-1], part)]
            }
        )
    if len(places) < MIN_FOCUS_PLACES:
        raise RunUnsuitable(
            f"has {len(places)} places, {MIN_FOCUS_PLACES} are needed",
            place=run,
            cure="rtpiv acquire --resume takes the rest",
        )
    order = np.argsort(places)
    z_mm = np.array(places)[order]
    # Beside the glass first, then ball by ball.
    names = sorted({name for each in found for name in each}, key=lambda name: (name != "beside", name))
    variance = {name: spot_variances_px2([found[k].get(name, NO_SPOTS) for k in order]) for name in names}
    best = tuple(best_focus(name, z_mm, variance[name]) for name in names)
    scale = scene.camera.focal_px / abs(scene.camera.position_mm[2] / scene.camera.rotation_matrix[2][2])
    magnification = scale * plan.pixel_pitch_um * 1e-3
    return FocusScan(plan.moves, z_mm, variance, best, magnification, plan.f_number, scene.wavelength_nm)
