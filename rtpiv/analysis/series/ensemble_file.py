"""Mean flow by ensemble correlation on disk: mean_ensemble.nc, NetCDF (t, y, x) with one t, y UP.

u, v and sigma_u, sigma_v [m s-1], R_uu, R_vv, R_uv and sigma_R_uu, _vv, _uv [m2 s-2], correlation (share of the
particles that stay), chc (1 = measured).  dt_sigma_u, dt_sigma_v [m s-1]: by that of dt, one factor for all
vectors (twice `delta_t_sigma_share` of a stress); missing if nobody measured it.
"""

import io
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from daq.errors import DiskError
from daq.whole_text import why
from ground.whole_file import whole_file
from rtpiv.analysis.series.chunk_file import NAMES, SCHEMA
from rtpiv.analysis.series.ensemble_series import EnsembleFlow


def write_ensemble(path: Path, flow: EnsembleFlow, about: dict[str, Any]) -> None:
    """Write it, atomically; `about` are global attributes. DiskError if it cannot be written."""
    speed, square = "m s-1", "m2 s-2"
    found: dict[str, tuple[NDArray[Any], str]] = {"correlation": (flow.correlation, "1")}
    for before, values, names, unit in (
        ("", flow.mean_m_s, ("u", "v"), speed),
        ("sigma_", flow.sigma_m_s, ("u", "v"), speed),
        ("R_", flow.stresses_m2_s2, ("uu", "vv", "uv"), square),
        ("sigma_R_", flow.stress_sigma_m2_s2, ("uu", "vv", "uv"), square),
    ):
        for number, name in enumerate(names):
            found[before + name] = (values[..., number], unit)
    if np.isfinite(flow.dt_sigma_share):
        for number, name in enumerate(("u", "v")):
            found[f"dt_sigma_{name}"] = (np.abs(flow.mean_m_s[..., number]) * flow.dt_sigma_share, speed)
    known = np.isfinite(flow.mean_m_s).all(axis=-1)
    found["chc"] = (np.asarray(known, np.int32), "1")
    buffer = io.BytesIO()
    with scipy.io.netcdf_file(buffer, "w", version=2) as file:
        for name, values, unit in (("t", np.zeros(1), "s"), ("y", flow.y_mm, "mm"), ("x", flow.x_mm, "mm")):
            file.createDimension(name, len(values))
            axis = file.createVariable(name, "f8", (name,))
            axis[:], axis.units, axis.standard_name, axis.axis = values, unit, NAMES[name], name.upper()
        for name, (values, unit) in found.items():
            variable = file.createVariable(name, "i4" if values.dtype.kind == "i" else "f8", ("t", "y", "x"))
            variable[0], variable.units = values, unit
            if name in NAMES:
                variable.standard_name = NAMES[name]
        file.Conventions = "CF-1.8"
        file.pivpy_schema_version = SCHEMA
        file.px_per_m_s, file.window_px, file.step_px = flow.px_per_m_s, flow.windows.size_px, flow.windows.step_px
        file.pairs_used, file.delta_t_sigma_share = flow.pairs, np.float64(flow.dt_sigma_share)
        for name, value in about.items():
            setattr(file, name, value)
        file.flush()
        content = buffer.getvalue()
    try:
        with whole_file(path) as stream:
            stream.write(content)
    except OSError as error:
        raise DiskError(f"{path}: {why(error)}; make room, then give the same command again") from error
