"""Vectors written for Tecplot, MATLAB and ParaView; each file whole or not there.

Tecplot and most readers of its text know no NaN: what was not measured is 0 there, and 0 in `measured`.
"""

import io
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from ground.whole_file import whole_file
from rtpiv.analysis.export.vector_table import VectorTable


def write_tecplot(table: VectorTable, path: Path) -> list[Path]:
    """Write one text file with a zone for each time (``.dat``, POINT packing)."""
    names = [*table.values, "measured"]
    shown = ", ".join(f'"{name}"' for name in ("x [mm]", "y [mm]", *(table.called(name) for name in names)))
    y, x = np.meshgrid(table.y_mm, table.x_mm, indexing="ij")
    text = io.StringIO()
    text.write(f'TITLE = "{table.title}"\nVARIABLES = {shown}\n')
    for number, time_s in enumerate(table.t_s.tolist()):
        text.write(f'ZONE T="{number}", I={len(table.x_mm)}, J={len(table.y_mm)}, DATAPACKING=POINT,')
        text.write(f" STRANDID=1, SOLUTIONTIME={time_s:.9g}\n")
        columns = [x, y, *(np.nan_to_num(one[number]) for one in table.values.values()), table.measured[number]]
        np.savetxt(text, np.column_stack([column.ravel() for column in columns]), fmt="%.9g")
    return _written(path.with_suffix(".dat"), text.getvalue().encode("utf-8"))


def write_matlab(table: VectorTable, path: Path) -> list[Path]:
    """Write one file of arrays (H, W, T) with names as here (``.mat``, version 5, which every MATLAB reads)."""
    arrays: dict[str, Any] = {name: np.moveaxis(one, 0, -1) for name, one in table.values.items()}
    arrays |= {"x_mm": table.x_mm, "y_mm": table.y_mm, "t_s": table.t_s}
    stream = io.BytesIO()
    units = {name: unit for name, unit in table.units.items() if unit}
    scipy.io.savemat(
        stream, {**arrays, "units": units, "title": table.title}, do_compression=True, oned_as="column"
    )
    return _written(path.with_suffix(".mat"), stream.getvalue())


def write_paraview(table: VectorTable, path: Path) -> list[Path]:
    """Write a rectilinear grid for each time (``.vtk``, legacy text); numbered files are a series for ParaView."""
    count = len(table.t_s)
    written = []
    for number in range(count):
        name = path.with_suffix(".vtk") if count == 1 else path.with_name(f"{path.stem}_{number:05d}.vtk")
        written += _written(name, "\n".join((*_vtk_lines(table, number), "")).encode("ascii", "replace"))
    return written


def _vtk_lines(table: VectorTable, number: int) -> Iterator[str]:
    yield from ("# vtk DataFile Version 3.0", table.title[:200] or "rtpiv", "ASCII", "DATASET RECTILINEAR_GRID")
    yield f"DIMENSIONS {len(table.x_mm)} {len(table.y_mm)} 1"
    for letter, axis in (("X", table.x_mm), ("Y", table.y_mm), ("Z", np.zeros(1))):
        yield f"{letter}_COORDINATES {len(axis)} double"
        yield " ".join(f"{value:.9g}" for value in axis)
    yield f"POINT_DATA {table.measured[number].size}"
    yield "VECTORS velocity double"
    u, v = (table.values[name][number].ravel() for name in "uv")
    yield from (f"{along:.9g} {up:.9g} 0" for along, up in zip(u, v, strict=True))
    for name, values in table.values.items():
        yield from (f"SCALARS {name} double 1", "LOOKUP_TABLE default")
        yield from (f"{value:.9g}" for value in values[number].ravel())


def _written(path: Path, content: bytes) -> list[Path]:
    with whole_file(path) as stream:
        stream.write(content)
    return [path]


FORMATS: dict[str, Callable[[VectorTable, Path], list[Path]]] = {
    "matlab": write_matlab,
    "paraview": write_paraview,
    "tecplot": write_tecplot,
}
