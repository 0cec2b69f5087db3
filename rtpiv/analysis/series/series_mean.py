"""The statistics of a series from its folder to mean.nc: vectors of one time, in the layout of the pairs.

What the fitted map is unsure of is added to the mean here, beside what more pairs would make surer.

mean.nc, where rows begin at the lowest y:

    u, v                          mean velocity [m s-1]
    sigma_u, sigma_v              random standard uncertainty of the mean, by the effective samples
    resolution                    standard uncertainty of u and of v by what windows do not resolve [m s-1]
    dt_sigma_u, dt_sigma_v        by that of delta_t, one factor for all vectors (`delta_t_sigma_share`); missing
                                  if that was not measured
    map_sigma_u, _v, _x, _y       by the fitted map: of the mean [m s-1] and of the place [mm]; no number of pairs
                                  makes it smaller, so it is kept apart; missing where there was no fit
    slant_sigma_u, _v             by a steady out-of-plane velocity w, which oblique viewing shows as
                                  one within it (`piv.statistics.out_of_plane`; `out_of_plane` says what w is
                                  taken to be); the same in all pairs, too
    dxdz, dydz (by place)         slopes of the rays: measured are u - w dxdz, v - w dydz; w is towards the camera
    total_sigma_u, _v             all of these that are known, as root sum of squares
    n, n_effective_u, _v          vectors, and their effective number
    R_uu, R_vv, R_uv              Reynolds stresses without the noise of correlation [m2 s-2]; may be below 0
    R_uu_measured, _vv_, _uv_     the same with it
    noise_uu, noise_vv            what was taken off: the mean of sigma^2 of the vectors
    sigma_R_uu, _vv, _uv          random standard uncertainty of the stresses
    resolution_R_uu, _vv, _uv     by how much they may be too small, as windows do not resolve it: an upper limit
    slant_R_uu, _vv, _uv          by how much they are too large (R_uv: off), as w changes from pair to pair; it is
                                  not taken off, and as unsure as slant_sigma_R_uu, _vv, _uv say
    vorticity, divergence, shear, swirling_strength [s-1]; sigma_vorticity ... (`piv.statistics.derived`)
    skewness_u, _v; lowest_u, _v, highest_u, _v
    chc                           1 where there is a mean

mean_ensemble.nc has of these u, v, sigma_u, sigma_v, dt_sigma_u, dt_sigma_v, the stresses R and sigma_R, chc,
dxdz, dydz and all that begins with slant_, with `correlation`, the share of the particles that stay.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.fitted.map_sigma import vector_map_sigma
from daq.atomic_write import GIVE_AGAIN, disk_errors
from daq.runs.run_views import length_unit
from piv.files.vector_file import LENGTH, PIXELS, SPEED, Vectors, write_vectors
from piv.statistics.derived import rates
from piv.statistics.out_of_plane import NOTHING_TOLD, OutOfPlane, SlantedField, SlantedStresses
from rtpiv.analysis.pairs.pair_vectors import RATE, SLOPES
from rtpiv.analysis.pairs.slanted import viewing_slopes
from rtpiv.analysis.series.ensemble_series import EnsembleFlow
from rtpiv.analysis.series.mean_flow import MeanFlow, image_field, mean_flow
from rtpiv.analysis.series.series_folder import MEAN, Chunks
from rtpiv.analysis.series.series_view import SeriesView

STRESS = "m2 s-2"
UV, STRESSES = ("u", "v"), ("uu", "vv", "uv")  # components, and last axes of arrays
Floats = NDArray[np.float64]
Named = dict[str, tuple[NDArray[Any], str]]  # values and their unit


def mean_of_series(view: SeriesView) -> MeanFlow:
    """Average a series; nothing is written but the maps that it needs.

    Parameters
    ----------
    view : SeriesView
        Of the series.

    Raises
    ------
    SeriesError
        A chunk is missing, damaged or made with other settings; or no pair has a vector.
    RunUnsuitable
        The folder is no series.
    ConfigError
        Its scene cannot be read.
    DiskError
        A map cannot be kept.
    """
    mean, sigma = mean_flow(Chunks.of(view.folder), view.settings), view.sigma
    found_map = view.correction.corrector.map
    slope = viewing_slopes(found_map, view.scene, view.windows, view.settings.window_sigma)
    mean = replace(mean, length=length_unit(view.scene))
    if slope is not None:
        mean = replace(mean, slope=slope[::-1], out_of_plane=view.out_of_plane)
    if isinstance(sigma, str):
        return replace(mean, no_map_sigma=sigma)
    field = image_field(mean.mean_m_s, mean.sigma_m_s, mean.px_per_m_s, view.windows)
    found = vector_map_sigma(field, found_map, view.scene, sigma)
    return replace(
        mean,
        map_sigma_m_s=found.displacement_px[::-1] / mean.px_per_m_s,
        map_sigma_position_mm=found.position_px[::-1] / mean.px_per_mm,
        map_common_m_s=found.common_px[::-1] / mean.px_per_m_s,
    )


def write_mean(view: SeriesView, mean: MeanFlow) -> None:
    """Write the mean.nc of a series into its folder; DiskError if that fails."""
    said = {
        "run": view.about["run"],
        "scene_hash": view.scene.content_hash(),
        "rtpiv_version": version("rtpiv"),
        **view.readings,
    }
    light, more = view.correction.light, dict[str, tuple[NDArray[Any], str]]()
    if light is not None and light.is_bent:
        places = np.stack(np.meshgrid(mean.x_mm, mean.y_mm), axis=-1)
        more["light_z"] = light.height_where_lit(places), LENGTH
    write_statistics(view.folder / MEAN, mean_vectors(mean, said, more))


def mean_vectors(
    mean: MeanFlow, about: Mapping[str, Any], more: Mapping[str, tuple[NDArray[Any], str]] | None = None
) -> Vectors:
    """Statistics of a series as vectors of one time.

    Parameters
    ----------
    mean : MeanFlow
        The statistics.
    about : dict
        Attributes.
    more : mapping of str to (ndarray, str), optional
        Further numbers (ny, nx) and their unit.
    """
    said: dict[str, Any] = {
        "delta_t": np.float64(mean.dt_s),
        "px_per_mm": mean.px_per_mm,
        "window_px": mean.window_px,
        "step_px": mean.step_px,
        "pairs_used": mean.used,
        "left_out": json.dumps(dict(mean.left_out)),
        "effective_samples": mean.effective.way,
        "effective_samples_converged": int(mean.effective.converged),
        "delta_t_sigma_share": np.float64(mean.dt_sigma_share),
        "no_map_sigma": mean.no_map_sigma or "known",
    }
    said |= mean.spheres or {}
    if mean.slope is not None:
        said["out_of_plane"] = mean.out_of_plane.sentence
    said |= {} if mean.length == "mm" else {"length_unit": PIXELS}
    named = _variables(mean) | dict(more or {})
    named = named if mean.is_timed else without_time(named, mean.length)
    return _with_slope(_one_time(mean.x_mm, mean.y_mm, named, said | dict(about)), mean.slope)


def without_time(found: Named, length: str) -> Named:
    """Return variables of displacements in place of velocities, in units of that length."""
    unit = LENGTH if length == "mm" else PIXELS
    units = {SPEED: unit, STRESS: f"{unit}2", RATE: "1", LENGTH: unit}
    return {
        name: (1e-3 * values if of == RATE else values, units.get(of, of)) for name, (values, of) in found.items()
    }


def ensemble_vectors(
    flow: EnsembleFlow,
    about: Mapping[str, Any],
    slope: Floats | None = None,
    known: OutOfPlane = NOTHING_TOLD,
) -> Vectors:
    """A mean by ensemble correlation as vectors of one time.

    Parameters
    ----------
    flow : EnsembleFlow
        The mean.
    about : dict
        Attributes.
    slope : (ny, nx, 2) float64, optional
        dX/dz, dY/dz of the rays that show its vectors, y up.
    known : OutOfPlane
        What is known of the velocity through the sheet.
    """
    dt_sigma = np.abs(flow.mean_m_s) * flow.dt_sigma_share if np.isfinite(flow.dt_sigma_share) else None
    found: Named = {"correlation": (flow.correlation, "1")} | _by_component(
        ("{}", UV, flow.mean_m_s, SPEED),
        ("sigma_{}", UV, flow.sigma_m_s, SPEED),
        ("R_{}", STRESSES, flow.stresses_m2_s2, STRESS),
        ("sigma_R_{}", STRESSES, flow.stress_sigma_m2_s2, STRESS),
        ("dt_sigma_{}", UV, dt_sigma, SPEED),
    )
    if slope is not None:
        field = SlantedField(flow.mean_m_s, flow.sigma_m_s, slope, flow.windows.size_px / flow.windows.step_px)
        sigma = field.sigma(known.of_mean(field))
        found |= _slant_variables(sigma, known.of_stresses(flow.stresses_m2_s2, slope))
        about = {**about, "out_of_plane": known.sentence}
    found["chc"] = (np.asarray(np.isfinite(flow.mean_m_s).all(axis=-1), np.int8), "1")
    said: dict[str, Any] = {
        "px_per_m_s": flow.px_per_m_s,
        "window_px": flow.windows.size_px,
        "step_px": flow.windows.step_px,
        "pairs_used": flow.pairs,
        "delta_t_sigma_share": np.float64(flow.dt_sigma_share),
    }
    found = found if flow.is_timed else without_time(found, flow.length)
    said |= {} if flow.length == "mm" else {"length_unit": PIXELS}
    return _with_slope(_one_time(flow.x_mm, flow.y_mm, found, said | dict(about)), slope)


def write_statistics(path: Path, vectors: Vectors) -> None:
    """Write the statistics of a series as NetCDF, atomically; DiskError if they cannot be written."""
    with disk_errors(path, GIVE_AGAIN):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_vectors(path, vectors)


def _one_time(x_mm: Floats, y_mm: Floats, found: Named, about: Mapping[str, Any]) -> Vectors:
    fields = {name: values[None] for name, (values, _) in found.items()}
    return Vectors(x_mm, y_mm, np.zeros(1), fields, {}, {name: unit for name, (_, unit) in found.items()}, about)


def _with_slope(vectors: Vectors, slope: Floats | None) -> Vectors:
    if slope is None:
        return vectors
    return replace(vectors, by_place=dict(zip(SLOPES, np.moveaxis(slope, -1, 0), strict=True)))


def _by_component(*parts: tuple[str, Sequence[str], Floats | None, str]) -> Named:
    """Return a variable for each component of arrays (..., components): pattern, components, array, unit.

    An array that is None has none.
    """
    return {
        pattern.format(name): (values[..., number], unit)
        for pattern, names, values, unit in parts
        if values is not None
        for number, name in enumerate(names)
    }


def _slant_variables(sigma_m_s: Floats | None, stresses: SlantedStresses | None) -> Named:
    """Return the perspective error of out-of-plane motion in a mean (ny, nx, 2) and in its stresses."""
    bias, sigma = (None, None) if stresses is None else (stresses.bias, stresses.sigma)
    return _by_component(
        ("slant_sigma_{}", UV, sigma_m_s, SPEED),
        ("slant_R_{}", STRESSES, bias, STRESS),
        ("slant_sigma_R_{}", STRESSES, sigma, STRESS),
    )


def _variables(mean: MeanFlow) -> Named:
    moments, has_mean = mean.moments, mean.count > 0
    lowest, highest = (np.where(has_mean[..., None], each, np.nan) for each in (moments.lowest, moments.highest))
    found: Named = {
        "n": (mean.count, "1"),
        "chc": (has_mean.astype(np.int8), "1"),
        "resolution": (mean.resolution_m_s, SPEED),
    }
    found |= _slant_variables(mean.slant_sigma_m_s, mean.perspective_stresses)
    found |= _by_component(
        ("{}", UV, mean.mean_m_s, SPEED),
        ("sigma_{}", UV, mean.sigma_m_s, SPEED),
        ("total_sigma_{}", UV, mean.total_sigma_m_s, SPEED),
        ("n_effective_{}", UV, mean.effective.samples, "1"),
        ("skewness_{}", UV, moments.skewness, "1"),
        ("lowest_{}", UV, lowest, SPEED),
        ("highest_{}", UV, highest, SPEED),
        ("dt_sigma_{}", UV, mean.dt_sigma_m_s if np.isfinite(mean.dt_sigma_share) else None, SPEED),
        ("map_sigma_{}", UV, mean.map_sigma_m_s, SPEED),
        ("map_sigma_{}", ("x", "y"), mean.map_sigma_position_mm, LENGTH),
        ("R_{}", STRESSES, mean.stresses_m2_s2, STRESS),
        ("R_{}_measured", STRESSES, mean.noisy_stresses_m2_s2, STRESS),
        ("sigma_R_{}", STRESSES, mean.stress_sigma_m2_s2, STRESS),
        ("resolution_R_{}", STRESSES, mean.stress_resolution_m2_s2, STRESS),
        ("noise_{}", STRESSES[:2], moments.noise, STRESS),
    )
    for name, (value, sigma) in rates(mean.field).items():
        found[name], found[f"sigma_{name}"] = (1e3 * value, RATE), (1e3 * sigma, RATE)  # m/s per mm
    return found
