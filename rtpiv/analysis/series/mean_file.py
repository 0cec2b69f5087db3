"""Statistics of a series on disk: NetCDF in the layout of its chunks, with one time.

Dimensions (t, y, x) with one t, so that PIVPy reads it as it reads a pair; y UP; rows from the lowest y:

    u, v                          mean velocity [m s-1]
    sigma_u, sigma_v              random standard uncertainty of the mean, by the effective samples
    resolution                    standard uncertainty of u and of v by what windows do not resolve [m s-1]
    dt_sigma_u, dt_sigma_v        by that of delta_t, one factor for all vectors (`delta_t_sigma_share`); missing
                                  if nobody measured it
    map_sigma_u, _v, _x, _y       by the fitted map: of the mean [m s-1] and of the place [mm]; no number of pairs
                                  makes it smaller, so it is kept apart; missing where there was no fit
    total_sigma_u, _v             all of these that are known, added as squares
    n, n_effective_u, _v          vectors, and independent ones that they are worth
    R_uu, R_vv, R_uv              Reynolds stresses without the noise of correlation [m2 s-2]; may be below 0
    R_uu_measured, _vv_, _uv_     the same with it
    noise_uu, noise_vv            what was taken off: the mean of sigma^2 of the vectors
    sigma_R_uu, _vv, _uv          random standard uncertainty of the stresses
    resolution_R_uu, _vv, _uv     by how much they may be too small, as windows do not resolve it: an upper limit
    skewness_u, _v; lowest_u, _v, highest_u, _v
    chc                           1 where there is a mean
"""

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from daq.errors import DiskError
from daq.whole_text import why
from ground.whole_file import whole_file
from rtpiv.analysis.series.chunk_file import NAMES, SCHEMA
from rtpiv.analysis.series.mean_flow import MeanFlow

Floats = NDArray[np.float64]


def write_mean(
    path: Path, mean: MeanFlow, about: dict[str, Any], more: Mapping[str, NDArray[Any]] | None = None
) -> None:
    """Write statistics as NetCDF, atomically; DiskError if it cannot be written.

    Parameters
    ----------
    path : Path
        The file.
    mean : MeanFlow
        The statistics.
    about : dict
        Global attributes.
    more : mapping of str to ndarray, optional
        Further numbers without a unit, (ny, nx).
    """
    buffer = io.BytesIO()
    with scipy.io.netcdf_file(buffer, "w", version=2) as file:
        for name, values, unit in (("t", np.zeros(1), "s"), ("y", mean.y_mm, "mm"), ("x", mean.x_mm, "mm")):
            file.createDimension(name, len(values))
            axis = file.createVariable(name, "f8", (name,))
            axis[:], axis.units, axis.standard_name, axis.axis = values, unit, NAMES[name], name.upper()
        for name, (values, unit) in {
            **_variables(mean),
            **{name: (each, "1") for name, each in (more or {}).items()},
        }.items():
            kind = "i4" if values.dtype.kind in "iu" else "f8"
            variable = file.createVariable(name, kind, ("t", "y", "x"))
            variable[0], variable.units = values, unit
            if name in NAMES:
                variable.standard_name = NAMES[name]
        file.Conventions = "CF-1.8"
        file.pivpy_schema_version = SCHEMA
        file.delta_t = np.float64(mean.dt_s)
        file.px_per_mm, file.window_px, file.step_px = mean.px_per_mm, mean.window_px, mean.step_px
        file.pairs_used, file.left_out = mean.used, json.dumps(dict(mean.left_out))
        file.effective_samples = mean.effective.way
        file.effective_samples_converged = int(mean.effective.converged)
        file.delta_t_sigma_share = np.float64(mean.dt_sigma_share)
        file.no_map_sigma = mean.no_map_sigma or "known"
        for name, value in about.items():
            setattr(file, name, value)
        file.flush()
        content = buffer.getvalue()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as stream:
            stream.write(content)
    except OSError as error:
        raise DiskError(f"{path}: {why(error)}; make room, then give the same command again") from error


def _variables(mean: MeanFlow) -> dict[str, tuple[NDArray[Any], str]]:
    moments = mean.moments
    there = mean.count > 0
    known = there[..., None]
    found: dict[str, tuple[NDArray[Any], str]] = {
        "n": (mean.count, "1"),
        "chc": (there.astype(np.int32), "1"),
        "resolution": (mean.resolution_m_s, "m s-1"),
    }
    speed, square = "m s-1", "m2 s-2"
    apart: list[tuple[str, str, Floats, str]] = [
        ("", "uv", mean.mean_m_s, speed),
        ("sigma_", "uv", mean.sigma_m_s, speed),
        ("total_sigma_", "uv", mean.total_sigma_m_s, speed),
        ("n_effective_", "uv", mean.effective.samples, "1"),
        ("skewness_", "uv", moments.skewness, "1"),
        ("lowest_", "uv", np.where(known, moments.lowest, np.nan), speed),
        ("highest_", "uv", np.where(known, moments.highest, np.nan), speed),
    ]
    if np.isfinite(mean.dt_sigma_share):
        apart.append(("dt_sigma_", "uv", mean.dt_sigma_m_s, speed))
    if mean.map_sigma_m_s is not None and mean.map_sigma_position_mm is not None:
        apart.append(("map_sigma_", "uv", mean.map_sigma_m_s, speed))
        apart.append(("map_sigma_", "xy", mean.map_sigma_position_mm, "mm"))
    for before, names, values, unit in apart:
        for number, name in enumerate(names):
            found[before + name] = (values[..., number], unit)
    for number, name in enumerate(("uu", "vv", "uv")):
        found[f"R_{name}"] = (mean.stresses_m2_s2[..., number], square)
        found[f"R_{name}_measured"] = (mean.noisy_stresses_m2_s2[..., number], square)
        found[f"sigma_R_{name}"] = (mean.stress_sigma_m2_s2[..., number], square)
        found[f"resolution_R_{name}"] = (mean.stress_resolution_m2_s2[..., number], square)
    for number, name in enumerate(("uu", "vv")):
        found[f"noise_{name}"] = (moments.noise[..., number], square)
    return found
