"""The light sheet of cameras at the same time: their corrected frames of a pulse, correlated with each other."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain, islice

import numpy as np
from numpy.typing import NDArray

from correction.light_sheet.two_cameras import SheetByViews, fit_sheet, name_moved
from correction.maps.slant import vector_slopes
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

STRANGERS = 2.0  # sigma that no sheet explains, from which a camera is asked for that was moved
MOST_FRAMES = 100  # that are compared, of both pulses
COMMON_PX = 0.003  # of all disparities: two balls, 50 pairs: the sheet came out 0.002 mm off, which is 0.002 px
Floats = NDArray[np.float64]


def sheet_of_views(series: Sequence[SeriesInput]) -> SheetByViews:
    """Measure the plane of the sheet over that for which the frames of views are corrected.

    Parameters
    ----------
    series : sequence of SeriesInput
        Views at the same time, pair by pair, on one grid; each is compared with the first.

    Raises
    ------
    SheetError
        The views have too little in common.
    PairError
        No frames of two views match.
    """
    first, *others = series
    corrector = correction_of(first.out / "maps", first.method).corrector
    grid, settings = corrector.map.grid, first.method.settings
    windows = settings.result_grid(grid.shape)
    slopes = [_slopes(each) for each in series]
    centres = np.stack(np.meshgrid(windows.x_px, windows.y_px), axis=-1)
    parts = list[tuple[Floats, Floats, Floats, Floats]]()
    rates = [_pose_rates(each).reshape(-1, 2, 6) for each in series]
    nothing = np.zeros_like(rates[0])
    by_pose = [[rates[0]] + [nothing] * len(others) for _ in others]
    for number, (other, slope) in enumerate(zip(others, slopes[1:], strict=True)):
        by_pose[number][number + 1] = -rates[number + 1]
        disparity, sigma = _disparity(first, other)
        parts.append((grid.to_mm(centres), disparity * grid.pitch_mm, sigma * grid.pitch_mm, slope - slopes[0]))
    place, apart, unsure, slope = (np.concatenate([part[k].reshape(-1, 2) for part in parts]) for k in range(4))
    independent = min(1.0, (windows.step_px / windows.size_px) ** 2)
    found = fit_sheet(place, apart, unsure, slope, independent, COMMON_PX * grid.pitch_mm)
    if not found.residual_sigma > STRANGERS:
        return found
    of_views = [np.concatenate([part[k] for part in by_pose]) for k in range(len(series))]
    return name_moved(found, (place, apart, unsure, slope), of_views, independent)


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


def _pose_rates(series: SeriesInput) -> Floats:
    """Derivatives (ny, nx, 2, 6) of the places that windows show by position and rotation of the camera."""
    found = correction_of(series.out / "maps", series.method).corrector.map
    windows = series.method.settings.result_grid(found.grid.shape)
    pixels = found.pixel[0][np.ix_(*(np.rint(axis).astype(int) for axis in (windows.y_px, windows.x_px)))]
    seen, rates = np.isfinite(pixels).all(axis=-1), np.full((*pixels.shape, 6), np.nan)
    rates[seen] = landings(series.method.scene, pixels[seen].astype(np.float64)).rate[:, :, :6]
    return rates


def _frames(series: SeriesInput) -> Iterator[NDArray[np.float32] | str]:
    """Corrected frames of both pulses, or why there is none: particles that leave the sheet enter it as well."""
    corrector = correction_of(series.out / "maps", series.method).corrector
    for job in series.jobs():
        for frame in chain.from_iterable(zip(clean_frames(job, 0), clean_frames(job, 1), strict=True)):
            yield frame if isinstance(frame, str) else corrector(frame)


def _disparity(first: SeriesInput, other: SeriesInput) -> tuple[Floats, Floats]:
    """Displacement (ny, nx, 2) [px], y up, from one view to another, and its random uncertainty."""
    count = min(MOST_FRAMES, 2 * len(first.given.pairs), 2 * len(other.given.pairs))
    seen = [correction_of(each.out / "maps", each.method).corrector.recovered for each in (first, other)]
    weight = total = square = np.zeros(())
    number, why = 0, ""
    frames = zip(islice(_frames(first), count), islice(_frames(other), count), strict=True)
    for a, b in progress(frames, count, "comparing the views"):
        try:
            if isinstance(a, str) or isinstance(b, str):
                raise FrameError(a if isinstance(a, str) else str(b))
            field = evaluate_pair(a, b, seen[0] & seen[1], first.method.settings)
        except (PairError, FrameError) as error:
            why = str(error)
            continue
        uv = np.stack((field.u_px, -field.v_px), axis=-1)
        one = 1.0 / np.square(np.stack((field.sigma_u_px, field.sigma_v_px), axis=-1))
        one = np.where(field.valid[..., None] & np.isfinite(uv * one), one, 0.0)
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
