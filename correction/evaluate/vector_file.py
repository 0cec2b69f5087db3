"""Vectors on disk: NetCDF for programs, VTK for pictures.

NetCDF (classic, 64-bit offsets) in the layout that PIVPy and xarray read: dimensions (y, x, t), coordinates in mm
with y UP and both axes rising, so that row 0 of the file is the lowest of the image.  Everything has the
dimensions (y, x, t):

    u, v                    displacement [mm per pair], NaN where there is no vector
    chc, mask, flag         1 = measured; 1 = masked; VectorFlag
    sigma_u, sigma_v        random standard uncertainty (correlation statistics) [mm]
    map_sigma_u, _v         that of the displacement by the fitted map [mm], the same in every pair
    map_sigma_x, _y         that of the position by the fitted map [mm]
    peak_ratio, correlation, valid_fraction
    route                   1 = the vector was traced (velocity route), only where routes were mixed

The map's sigmas are there where a fit was beside the scene.  Divide by delta_t for velocity.  Vectors of the
velocity route lie on no grid; `write_traced` lists them along one dimension, vector.
"""

import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.io import netcdf_file

from correction.evaluate.vector_field import VectorField, VectorFlag
from correction.evaluate.vector_map_sigma import VectorMapSigma
from correction.evaluate.velocity_route import PlaneVectors
from correction.grid import PlaneGrid
from tracer.whole_file import whole_file

SCHEMA = 1
UNITS = dict.fromkeys(("x", "y", "u", "v", "sigma_u", "sigma_v"), "mm")
UNITS |= {f"map_sigma_{axis}": "mm" for axis in "uvxy"}
STANDARD = {"u": "u_velocity", "v": "v_velocity", "chc": "validity_flag"}


def write_netcdf(
    path: Path,
    field: VectorField,
    grid: PlaneGrid,
    about: dict[str, Any],
    map_sigma: VectorMapSigma | None = None,
    by_velocity: NDArray[np.bool_] | None = None,
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
    buffer = io.BytesIO()
    with netcdf_file(buffer, "w", version=2) as file:
        for name, size in (("y", len(y_mm)), ("x", len(x_mm)), ("t", 1)):
            file.createDimension(name, size)
        for name, values, unit in (("x", x_mm, "mm"), ("y", y_mm, "mm"), ("t", np.zeros(1), "frame")):
            axis = file.createVariable(name, "f8", (name,))
            axis[:] = values
            axis.units = unit
        for name, values in variables.items():
            kind = "i4" if values.dtype.kind in "iu" else "f8"
            variable = file.createVariable(name, kind, ("y", "x", "t"))
            variable[:] = values[::-1, :, None]
            variable.units = UNITS.get(name, "1")
            if name in STANDARD:
                variable.standard_name = STANDARD[name]
        file.Conventions = "CF-1.8"
        file.pivpy_schema_version = SCHEMA
        file.delta_t = 0.0
        file.flag_meanings = ", ".join(f"{flag.value} {flag.name.lower()}" for flag in VectorFlag)
        for name, value in about.items():
            setattr(file, name, value)
        file.flush()
        content = buffer.getvalue()
    with whole_file(path) as stream:
        stream.write(content)


def write_traced(path: Path, traced: PlaneVectors, about: dict[str, Any]) -> None:
    """Write vectors of the velocity route as NetCDF, atomically: a list with x, y, u, v and their sigma in mm."""
    columns: dict[str, NDArray[Any]] = {
        "x": traced.place_mm[:, 0],
        "y": traced.place_mm[:, 1],
        "u": traced.shift_mm[:, 0],
        "v": traced.shift_mm[:, 1],
        "sigma_u": traced.sigma_mm[:, 0],
        "sigma_v": traced.sigma_mm[:, 1],
        "branch": traced.branch.astype(np.int32),
    }
    buffer = io.BytesIO()
    with netcdf_file(buffer, "w", version=2) as file:
        file.createDimension("vector", len(traced.branch))
        for name, values in columns.items():
            variable = file.createVariable(name, "i4" if values.dtype.kind in "iu" else "f8", ("vector",))
            variable[:] = values
            variable.units = UNITS.get(name, "1")
        file.Conventions = "CF-1.8"
        for name, value in about.items():
            setattr(file, name, value)
        file.flush()
        content = buffer.getvalue()
    with whole_file(path) as stream:
        stream.write(content)


def write_vtk(path: Path, field: VectorField, grid: PlaneGrid) -> None:
    """Write a vector field as legacy VTK text (structured grid on z = 0, mm), atomically; NaN where no vector."""
    x_mm, y_mm = _axes(field, grid)
    values = _variables(field, grid)
    count = len(x_mm) * len(y_mm)
    lines = ["# vtk DataFile Version 3.0", "rtpiv displacement [mm]", "ASCII", "DATASET STRUCTURED_GRID"]
    lines += [f"DIMENSIONS {len(x_mm)} {len(y_mm)} 1", f"POINTS {count} double"]
    lines += [f"{x:.6f} {y:.6f} 0" for y in y_mm for x in x_mm]
    lines += [f"POINT_DATA {count}", "VECTORS displacement double"]
    lines += [f"{u:.9g} {v:.9g} 0" for u, v in zip(values["u"].ravel(), values["v"].ravel(), strict=True)]
    lines += ["SCALARS flag int 1", "LOOKUP_TABLE default", *(str(flag) for flag in values["flag"].ravel())]
    with whole_file(path) as stream:
        stream.write("\n".join((*lines, "")).encode("ascii"))


def _axes(field: VectorField, grid: PlaneGrid) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """X [mm] rising, y [mm] falling with the rows."""
    x_mm = grid.origin_mm[0] + field.x_px * grid.pitch_mm
    return x_mm, grid.origin_mm[1] - field.y_px * grid.pitch_mm


def _variables(field: VectorField, grid: PlaneGrid) -> dict[str, NDArray[Any]]:
    """Variables (ny, nx) in mm, y up."""
    pitch = grid.pitch_mm
    return {
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
