"""The light sheet of cameras at the same time: their corrected frames of a pulse, correlated with each other."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain, islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.grid import PlaneGrid
from correction.light_sheet.two_cameras import POSE_SIGMA, SheetByViews, fit_sheet, name_moved
from correction.maps.slant import SLOPE_NODE_STEP, WindowMeans, vector_slopes
from correction.self_check.knocks import Candidate
from correction.self_check.moved_sphere import MOVE_PRIOR_MM
from daq.atomic_write import write_text
from ground.terminal import progress
from piv.correlation.pair import evaluate_pair
from piv.errors import FrameError, PairError
from rtpiv.analysis.fit_beside import SCENE_FILE
from rtpiv.analysis.series.chunk import correction_of
from rtpiv.analysis.series.clean_frames import clean_frames
from rtpiv.analysis.series.series_input import SeriesInput
from tracer.light_sheet import LightSheet
from tracer.scene.scene_file import dump_scene, load_priors, load_scene
from tracer.strategies.sensitivity import landings

# By this frames of two views are set apart, half of it each: what both show at one place is no static light.  More
# than the picture of a particle in a sheet seen at 41 degrees, less than a quarter of the first windows.
APART_PX = 8
MOST_FRAMES, CHECKED_FRAMES = 100, 10  # that are compared, of both pulses, to measure the sheet; and to check it
# Of all disparities: two balls, 50 pairs: the sheet came out 0.002 mm off, which is 0.002 px
COMMON_PX = 0.003
POSE = tuple(f"camera.{name}" for name in ("x", "y", "z", "rx", "ry", "rz"))
BALL = "ball "  # begins the name of a candidate
SHEET_SIGMA = np.array([0.3, 0.003, 0.003])  # mm, and slopes: of a move of the light sheet that is looked for
Floats = NDArray[np.float64]


def sheet_of_views(series: Sequence[SeriesInput], most: int = MOST_FRAMES) -> SheetByViews:
    """Measure the plane of the sheet over that for which the frames of views are corrected.

    Parameters
    ----------
    series : sequence of SeriesInput
        Views at the same time, pair by pair, on one grid; each is compared with the first.
    most : int
        Frames that are compared.

    Raises
    ------
    SheetError
        The views have too little in common.
    PairError
        No frames of two views match.
    """
    first, *others = series
    grid, places = _places(first)
    windows = first.method.settings.result_grid(grid.shape)
    slopes = [_slopes(each) for each in series]
    parts = list[tuple[Floats, Floats, Floats, Floats]]()
    for other, slope in zip(others, slopes[1:], strict=True):
        disparity, sigma = _disparity(first, other, most)
        of_mm = disparity * grid.pitch_mm, sigma * grid.pitch_mm
        parts.append((places, *of_mm, slope - slopes[0]))
    place, apart, unsure, slope = (np.concatenate([part[k].reshape(-1, 2) for part in parts]) for k in range(4))
    independent = min(1.0, (windows.step_px / windows.size_px) ** 2)
    found = fit_sheet(place, apart, unsure, slope, independent, COMMON_PX * grid.pitch_mm)
    return name_moved(found, (place, apart, unsure, slope), _of_poses(series), independent)


def set_sheet(series: Sequence[SeriesInput], found: SheetByViews) -> LightSheet:
    """Write the sheet into the scene files of the folders of views; return that of the first."""
    sheets = []
    for each in series:
        file = each.out / SCENE_FILE
        scene = load_scene(file)
        sheets.append(found.sheet(scene.sheet or LightSheet()))
        write_text(file, dump_scene(replace(scene, sheet=sheets[-1]), load_priors(file)))
    return sheets[0]


def _slopes(series: SeriesInput) -> Floats:
    method, found = series.method, correction_of(series.out / "maps", series.method).corrector.map
    windows = method.settings.result_grid(found.grid.shape)
    return vector_slopes(found, method.scene, windows, method.settings.window_sigma)


def position_rates(series: SeriesInput, names: Sequence[str]) -> Floats:
    """Return the derivatives (N, 2, P) of the places that windows show by numbers of the scene, means of windows.

    Across the rim of a ball they jump, by as much as they are.
    """
    method, found = series.method, correction_of(series.out / "maps", series.method).corrector.map
    pixels = found.pixel[0][::SLOPE_NODE_STEP, ::SLOPE_NODE_STEP]
    seen = np.isfinite(pixels).all(axis=-1)
    rates = np.full((*seen.shape, 2 * len(names)), np.nan)
    rays = landings(method.scene, pixels[seen].astype(np.float64))
    rates[seen] = rays.columns(names).reshape(-1, 2 * len(names))
    windows = method.settings.result_grid(found.grid.shape)
    means = WindowMeans(windows, method.settings.window_sigma, found.grid.shape).of(rates)
    return means.reshape(-1, 2, len(names))


def _of_poses(series: Sequence[SeriesInput]) -> list[Floats]:
    """Derivatives of all disparities by the pose of each camera."""
    first, *others = (position_rates(each, POSE) for each in series)
    nothing = np.zeros_like(first)
    found = [np.concatenate([first] * len(others))]
    for number, rates in enumerate(others):
        parts = [nothing] * len(others)
        parts[number] = -rates
        found.append(np.concatenate(parts))
    return found


def _frames(series: SeriesInput) -> Iterator[NDArray[np.float32] | str]:
    """Corrected frames of both pulses, or why there is none: particles that leave the sheet enter it as well."""
    corrector = correction_of(series.out / "maps", series.method).corrector
    for job in series.jobs():
        for frame in chain.from_iterable(zip(clean_frames(job, 0), clean_frames(job, 1), strict=True)):
            yield frame if isinstance(frame, str) else corrector(frame)


def _disparities(first: SeriesInput, other: SeriesInput, count: int) -> Iterator[tuple[Floats, Floats] | str]:
    """Displacements (ny, nx, 2) [px], y up, from one view to another, frame by frame, and their uncertainty."""
    seen = [correction_of(each.out / "maps", each.method).corrector.recovered for each in (first, other)]
    half = APART_PX // 2
    valid = _aside(seen[0] & seen[1], -half, False) & _aside(seen[0] & seen[1], half, False)
    settings = replace(first.method.settings, denoise=0.0)  # what glass does has detail that is weaker than noise
    frames = zip(islice(_frames(first), count), islice(_frames(other), count), strict=True)
    for a, b in progress(frames, count, "comparing the views"):
        try:
            if isinstance(a, str) or isinstance(b, str):
                raise FrameError(a if isinstance(a, str) else str(b))
            field = evaluate_pair(_aside(a, -half, np.nan), _aside(b, half, np.nan), valid, settings)
        except (PairError, FrameError) as error:
            yield str(error)
            continue
        uv = np.stack((field.u_px - APART_PX, -field.v_px), axis=-1)
        uv = np.where(field.valid[..., None], uv, np.nan)
        sigma = np.stack((field.sigma_u_px, field.sigma_v_px), axis=-1)
        yield uv, sigma


def _aside(frame: NDArray[Any], columns: int, beyond: float) -> NDArray[Any]:
    """Return a frame (H, W) shifted along its rows, with another value where nothing was."""
    shifted = np.roll(frame, columns, axis=1)
    shifted[:, slice(0, columns) if columns > 0 else slice(columns, None)] = beyond
    return shifted


def _disparity(first: SeriesInput, other: SeriesInput, most: int) -> tuple[Floats, Floats]:
    """Mean of the displacements, and its random uncertainty."""
    count = min(most, 2 * len(first.given.pairs), 2 * len(other.given.pairs))
    weight = total = square = np.zeros(())
    number, why = 0, ""
    for found in _disparities(first, other, count):
        if isinstance(found, str):
            why = found
            continue
        uv, sigma = found
        one = 1.0 / np.square(sigma)
        one = np.where(np.isfinite(uv * one), one, 0.0)
        uv = np.where(one > 0.0, uv, 0.0)
        number += 1
        weight, total, square = weight + one, total + one * uv, square + one * uv**2
    if not number:
        raise PairError(f"no frames of two views match; the last: {why}")
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = total / weight
        # Stated noise, or the scatter of the pairs where that is more.
        scatter = np.maximum(square / weight - mean**2, 0.0) / max(number - 1, 1)
        return mean, np.sqrt(np.maximum(1.0 / weight, scatter))


def disparities_of(series: Sequence[SeriesInput], pairs: int) -> Floats:
    """Disparities (K, N, 2) [mm] of each pair from the first view to the others; NaN where not known.

    Parameters
    ----------
    series : sequence of SeriesInput
        As for `sheet_of_views`.
    pairs : int
        Pairs that are compared.
    """
    first, *others = series
    grid, places = _places(first)
    parts = []
    for other in others:
        found = _disparities(first, other, 2 * pairs)
        both = np.full((2 * pairs, len(places), 2), np.nan)
        for number, one in enumerate(found):
            if not isinstance(one, str):
                both[number] = one[0].reshape(-1, 2)
        of_pulses = both.reshape(pairs, 2, -1, 2)
        parts.append(of_pulses.mean(axis=1) * grid.pitch_mm)
    return np.concatenate(parts, axis=1)


def _places(series: SeriesInput) -> tuple[PlaneGrid, Floats]:
    """Grid of the corrected frames, and the places (N, 2) [mm] of its windows."""
    grid = correction_of(series.out / "maps", series.method).corrector.map.grid
    windows = series.method.settings.result_grid(grid.shape)
    centres = np.stack(np.meshgrid(windows.x_px, windows.y_px), axis=-1)
    return grid, grid.to_mm(centres).reshape(-1, 2)


def candidates_of(series: Sequence[SeriesInput]) -> list[Candidate]:
    """Return the cameras, the balls that all views know, and the light sheet: each may move."""
    _, places = _places(series[0])
    found = [
        Candidate(f"the camera of view {number}", rates, POSE_SIGMA)
        for number, rates in enumerate(_of_poses(series), start=1)
    ]
    balls = [{ball.name for ball in each.method.scene.spheres} for each in series]
    for name in sorted(set.intersection(*balls)):
        own, *their = (position_rates(each, [f"{name}.{axis}" for axis in "xyz"]) for each in series)
        rates = np.concatenate([own - one for one in their])
        prior = np.full(3, MOVE_PRIOR_MM)
        found.append(Candidate(f"{BALL}{name}", rates, prior))
    slopes = [_slopes(each).reshape(-1, 2) for each in series]
    height = np.column_stack((np.ones(len(places)), places))
    steeper = [(one - slopes[0])[..., None] for one in slopes[1:]]
    rates = np.concatenate([-more * height[:, None, :] for more in steeper])
    return [*found, Candidate("the light sheet", rates, SHEET_SIGMA)]
