"""Vectors on disk: NetCDF for programs, VTK for pictures.

NetCDF (classic, 64-bit offsets) in the layout that PIVPy and xarray read: dimensions (y, x, t), variables u, v
and chc (1 = measured), coordinates in mm with y UP, CF attributes.  Everything this house adds (flags, sigma,
peak ratio, mask) has the same dimensions.  Displacements are mm per frame pair; divide by delta_t for velocity.
"""

import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.io import netcdf_file

from correction.evaluate.vector_field import VectorField, VectorFlag
from correction.grid import PlaneGrid
from tracer.whole_file import whole_file

SCHEMA = "1"
UNITS = {"u": "mm", "v": "mm", "sigma_u": "mm", "sigma_v": "mm"}
STANDARD = {"u": "u_velocity", "v": "v_velocity", "chc": "validity_flag"}


def write_netcdf(path: Path, field: VectorField, grid: PlaneGrid, about: dict[str, Any]) -> None:
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
    """
    x_mm, y_mm = _axes(field, grid)
    buffer = io.BytesIO()
    with netcdf_file(buffer, "w", version=2) as file:
        for name, size in (("y", len(y_mm)), ("x", len(x_mm)), ("t", 1)):
            file.createDimension(name, size)
        for name, values, unit in (("x", x_mm, "mm"), ("y", y_mm, "mm"), ("t", np.zeros(1), "frame")):
            axis = file.createVariable(name, "f8", (name,))
            axis[:] = values
            axis.units = unit
        for name, values in _variables(field, grid).items():
            kind = "i4" if values.dtype.kind in "iu" else "f8"
            variable = file.createVariable(name, kind, ("y", "x", "t"))
            variable[:] = values[:, :, None]
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
