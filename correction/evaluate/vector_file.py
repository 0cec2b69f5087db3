"""Vectors on disk: NetCDF for programs, VTK for pictures.

NetCDF (classic, 64-bit offsets) in the layout that PIVPy and xarray read: dimensions (y, x, t), coordinates in mm
with y UP and both axes rising, so that row 0 of the file is the lowest of the image.  Everything has the
dimensions (y, x, t):

    u, v                    velocity [mm/s] where the time between the frames is known (delta_t [s] is not 0), else
                            displacement [mm]; standard_name says which; NaN where there is no vector
    chc, mask, flag         1 = measured; 1 = masked; VectorFlag
    sigma_u, sigma_v        random standard uncertainty (correlation statistics) of u, v
    resolution              standard uncertainty of u and of v by what windows do not resolve
    map_sigma_u, _v         that by the fitted map, the same in every pair
    map_sigma_x, _y         that of the position by the fitted map [mm]
    peak_ratio, correlation, valid_fraction
    route                   1 = the vector was traced (velocity route), only where routes were mixed

The map's sigmas are there where a fit was beside the scene.  Vectors of the velocity route lie on no grid;
`write_traced` lists them along one dimension, vector.
"""

import io
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.evaluate.velocity_route import PlaneVectors
from correction.fitted.vector_map_sigma import VectorMapSigma
from correction.grid import PlaneGrid
from ground.whole_file import whole_file
from piv.correlation.vector_field import VectorField, VectorFlag

SCHEMA = 1
PLACES = ("x", "y", "map_sigma_x", "map_sigma_y")
WAYS = ("u", "v", "sigma_u", "sigma_v", "resolution", "map_sigma_u", "map_sigma_v")  # in mm, or in mm/s


def write_netcdf(
    path: Path,
    field: VectorField,
    grid: PlaneGrid,
    about: dict[str, Any],
    map_sigma: VectorMapSigma | None = None,
    by_velocity: NDArray[np.bool_] | None = None,
    dt_s: float | None = None,
) -> None:
    """Write a vector field as NetCDF, atomically.

    Parameters
    ----------
    path : Path
        Final name.
    field : VectorField
        Vectors on the corrected image.
    grid : PlaneGrid
        Its scale and origin.
    about : dict of str to str, int or float
        Global attributes, such as the hash of the scene.
    map_sigma : VectorMapSigma, optional
        Uncertainty by the fitted map.
    by_velocity : (ny, nx) bool, optional
        Vectors of the velocity route.
    dt_s : float, optional
        Time between the frames; without it vectors are displacements.
    """
    x_mm, y_mm = _axes(field, grid)
    y_mm = y_mm[::-1]
    variables = _variables(field, grid)
    if map_sigma is not None:
        for names, values in (("uv", map_sigma.displacement_px), ("xy", map_sigma.position_px)):
            for number, axis in enumerate(names):
                variables[f"map_sigma_{axis}"] = values[..., number] * grid.pitch_mm
    if by_velocity is not None:
        variables["route"] = by_velocity.astype(np.int32)
    units, kind = _units(dt_s), "displacement" if dt_s is None else "velocity"
    standard = {"u": f"u_{kind}", "v": f"v_{kind}", "chc": "validity_flag"}
    buffer = io.BytesIO()
    with scipy.io.netcdf_file(buffer, "w", version=2) as file:
        for name, size in (("y", len(y_mm)), ("x", len(x_mm)), ("t", 1)):
            file.createDimension(name, size)
        for name, values, unit in (("x", x_mm, "mm"), ("y", y_mm, "mm"), ("t", np.zeros(1), "frame")):
            axis = file.createVariable(name, "f8", (name,))
            axis[:] = values
            axis.units = unit
        for name, values in variables.items():
            kind = "i4" if values.dtype.kind in "iu" else "f8"
            variable = file.createVariable(name, kind, ("y", "x", "t"))
            variable[:] = (_per_time(values, dt_s) if name in WAYS else values)[::-1, :, None]
            variable.units = units.get(name, "1")
            if name in standard:
                variable.standard_name = standard[name]
        file.Conventions = "CF-1.8"
        file.pivpy_schema_version = SCHEMA
        file.delta_t = np.float64(dt_s or 0.0)
        file.flag_meanings = ", ".join(f"{flag.value} {flag.name.lower()}" for flag in VectorFlag)
        for name, value in about.items():
            setattr(file, name, value)
        file.flush()
        content = buffer.getvalue()
    with whole_file(path) as stream:
        stream.write(content)


def write_traced(path: Path, traced: PlaneVectors, about: dict[str, Any], dt_s: float | None = None) -> None:
    """Write vectors of the velocity route as NetCDF, atomically: a list with x, y, u, v and the sigma of these."""
    columns: dict[str, NDArray[Any]] = {
        "x": traced.place_mm[:, 0],
        "y": traced.place_mm[:, 1],
        "u": traced.shift_mm[:, 0],
        "v": traced.shift_mm[:, 1],
        "sigma_u": traced.sigma_mm[:, 0],
        "sigma_v": traced.sigma_mm[:, 1],
        "branch": traced.branch.astype(np.int32),
    }
    units, buffer = _units(dt_s), io.BytesIO()
    with scipy.io.netcdf_file(buffer, "w", version=2) as file:
        file.createDimension("vector", len(traced.branch))
        for name, values in columns.items():
            variable = file.createVariable(name, "i4" if values.dtype.kind in "iu" else "f8", ("vector",))
            variable[:] = _per_time(values, dt_s) if name in WAYS else values
            variable.units = units.get(name, "1")
        file.Conventions = "CF-1.8"
        file.delta_t = np.float64(dt_s or 0.0)
        for name, value in about.items():
            setattr(file, name, value)
        file.flush()
        content = buffer.getvalue()
    with whole_file(path) as stream:
        stream.write(content)


def write_vtk(path: Path, field: VectorField, grid: PlaneGrid, dt_s: float | None = None) -> None:
    """Write a vector field as legacy VTK text (structured grid on z = 0, mm), atomically; NaN where no vector."""
    what, unit = ("displacement", "mm") if dt_s is None else ("velocity", "mm/s")
    x_mm, y_mm = _axes(field, grid)
    values = _variables(field, grid)
    count = len(x_mm) * len(y_mm)
    lines = ["# vtk DataFile Version 3.0", f"rtpiv {what} [{unit}]", "ASCII", "DATASET STRUCTURED_GRID"]
    lines += [f"DIMENSIONS {len(x_mm)} {len(y_mm)} 1", f"POINTS {count} double"]
    lines += [f"{x:.6f} {y:.6f} 0" for y in y_mm for x in x_mm]
    lines += [f"POINT_DATA {count}", f"VECTORS {what} double"]
    u, v = (_per_time(values[name], dt_s).ravel() for name in "uv")
    lines += [f"{along:.9g} {up:.9g} 0" for along, up in zip(u, v, strict=True)]
    lines += ["SCALARS flag int 1", "LOOKUP_TABLE default", *(str(flag) for flag in values["flag"].ravel())]
    with whole_file(path) as stream:
        stream.write("\n".join((*lines, "")).encode("ascii"))


def _units(dt_s: float | None) -> dict[str, str]:
    return dict.fromkeys(PLACES, "mm") | dict.fromkeys(WAYS, "mm" if dt_s is None else "mm/s")


def _per_time(values: NDArray[Any], dt_s: float | None) -> NDArray[Any]:
    return values if dt_s is None else values / dt_s


def _axes(field: VectorField, grid: PlaneGrid) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """X [mm] rising, y [mm] falling with the rows."""
    x_mm = grid.origin_mm[0] + field.x_px * grid.pitch_mm
    return x_mm, grid.origin_mm[1] - field.y_px * grid.pitch_mm


def _variables(field: VectorField, grid: PlaneGrid) -> dict[str, NDArray[Any]]:
    """Variables (ny, nx) in mm, y up."""
    pitch = grid.pitch_mm
    unresolved = {} if field.resolution_px is None else {"resolution": field.resolution_px * pitch}
    return unresolved | {
        "u": field.u_px * pitch,
        "v": -field.v_px * pitch,
        "chc": field.valid.astype(np.int32),
        "mask": (field.flags == VectorFlag.MASKED).astype(np.int32),
        "flag": field.flags.astype(np.int32),
        "sigma_u": field.sigma_u_px * pitch,
        "sigma_v": field.sigma_v_px * pitch,
        "peak_ratio": field.peak_ratio,
        "correlation": field.correlation,
        "valid_fraction": field.valid_fraction,
    }
