"""Vectors on disk: NetCDF for programs, VTK for pictures.

NetCDF (classic, 64-bit offsets) in the layout that PIVPy and xarray read: dimensions (y, x, t), variables u, v
and chc (1 = measured), coordinates in mm with y UP, CF attributes.  Everything this house adds (flags, sigma,
peak ratio, mask) has the same dimensions.  Displacements are mm per frame pair; divide by delta_t for velocity.
"""

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.io import netcdf_file

from correction.evaluate.vector_field import VectorField, VectorFlag
from correction.grid import PlaneGrid

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
    temporary = path.with_name(path.name + ".part")
    try:
        with netcdf_file(str(temporary), "w", version=2) as file:
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
        _settle(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_vtk(path: Path, field: VectorField, grid: PlaneGrid) -> None:
    """Write a vector field as legacy VTK text (structured grid on z = 0, mm), atomically; NaN where no vector."""
    x_mm, y_mm = _axes(field, grid)
    values = _variables(field, grid)
    temporary = path.with_name(path.name + ".part")
    count = len(x_mm) * len(y_mm)
    try:
        with temporary.open("w", encoding="ascii") as stream:
            stream.write("# vtk DataFile Version 3.0\nrtpiv displacement [mm]\nASCII\nDATASET STRUCTURED_GRID\n")
            stream.write(f"DIMENSIONS {len(x_mm)} {len(y_mm)} 1\nPOINTS {count} double\n")
            for y in y_mm:
                stream.writelines(f"{x:.6f} {y:.6f} 0\n" for x in x_mm)
            stream.write(f"POINT_DATA {count}\nVECTORS displacement double\n")
            for u, v in zip(values["u"].ravel(), values["v"].ravel(), strict=True):
                stream.write(f"{u:.9g} {v:.9g} 0\n")
            stream.write("SCALARS flag int 1\nLOOKUP_TABLE default\n")
            stream.writelines(f"{flag}\n" for flag in values["flag"].ravel())
        _settle(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


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


def _settle(temporary: Path, path: Path) -> None:
    """Flush to disk, then give the final name."""
    with temporary.open("rb+") as stream:
        os.fsync(stream.fileno())
    temporary.replace(path)
