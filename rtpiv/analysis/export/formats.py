"""Vectors written for Tecplot, MATLAB and ParaView; each file whole or not there.

Tecplot and most readers of its text know no NaN: what was not measured is 0 there, and 0 in `measured`.
"""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from ground.whole_file import whole_file
from piv.files.vector_file import Vectors, write_vtk


def write_tecplot(path: Path, vectors: Vectors) -> list[Path]:
    """Write one text file with a zone for each time (``.dat``, POINT packing)."""
    fields = vectors.everything
    names = [*fields, "measured"]
    shown = ", ".join(f'"{name}"' for name in ("x [mm]", "y [mm]", *(vectors.called(name) for name in names)))
    y, x = np.meshgrid(vectors.y_mm, vectors.x_mm, indexing="ij")
    text = io.StringIO()
    text.write(f'TITLE = "{_title(vectors, path)}"\nVARIABLES = {shown}\n')
    for number, time_s in enumerate(vectors.times.tolist()):
        text.write(f'ZONE T="{number}", I={len(vectors.x_mm)}, J={len(vectors.y_mm)}, DATAPACKING=POINT,')
        text.write(f" STRANDID=1, SOLUTIONTIME={time_s:.9g}\n")
        columns = [x, y, *(np.nan_to_num(one[number]) for one in fields.values()), vectors.measured[number]]
        np.savetxt(text, np.column_stack([column.ravel() for column in columns]), fmt="%.9g")
    return _written(path.with_suffix(".dat"), text.getvalue().encode("utf-8"))


def write_matlab(path: Path, vectors: Vectors) -> list[Path]:
    """Write one file of arrays (H, W, T) with names as here (``.mat``, version 5, which every MATLAB reads)."""
    arrays: dict[str, Any] = {name: np.moveaxis(one, 0, -1) for name, one in vectors.everything.items()}
    arrays |= {"x_mm": vectors.x_mm, "y_mm": vectors.y_mm, "t_s": vectors.times}
    stream = io.BytesIO()
    units = {name: unit for name, unit in vectors.units.items() if unit}
    scipy.io.savemat(
        stream, {**arrays, "units": units, "title": _title(vectors, path)}, do_compression=True, oned_as="column"
    )
    return _written(path.with_suffix(".mat"), stream.getvalue())


def _title(vectors: Vectors, path: Path) -> str:
    """What a file is called: as it says itself, or by its name."""
    return str(vectors.attributes.get("title") or path.stem).replace('"', "")


def _written(path: Path, content: bytes) -> list[Path]:
    with whole_file(path) as stream:
        stream.write(content)
    return [path]


FORMATS: dict[str, Callable[[Path, Vectors], list[Path]]] = {
    "matlab": write_matlab,
    "paraview": write_vtk,
    "tecplot": write_tecplot,
}
