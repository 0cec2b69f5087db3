"""Vectors as a table of times, rows and columns, from any NetCDF file that rtpiv writes of a grid.

Pairs lie as (y, x, t), statistics and chunks of a series as (t, y, x); here all lie as (t, y, x), rows from the
lowest y.  Numbers of a whole time are spread over its places.  Vectors that are traced or tracked lie on no grid,
and stay where they are.
"""

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from daq.errors import RunUsageError

GRID = ("t", "y", "x")
LARGEST = 1 << 31  # bytes
DAMAGE = (ValueError, TypeError, IndexError, KeyError, AttributeError, OverflowError, AssertionError, EOFError,
          MemoryError, NotImplementedError, struct.error)  # fmt: skip


@dataclass(frozen=True)
class VectorTable:
    """Vectors of T times on a grid.

    Parameters
    ----------
    title : str
        Of the file.
    x_mm, y_mm, t_s : (W,), (H,), (T,) float64
        Places and times; both axes rise.
    values : dict of str to (T, H, W) float64
        By name; NaN where there is none.
    units : dict of str to str
        Of those that have one.
    """

    title: str
    x_mm: NDArray[np.float64]
    y_mm: NDArray[np.float64]
    t_s: NDArray[np.float64]
    values: dict[str, NDArray[np.float64]]
    units: dict[str, str]

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Where there is a vector (T, H, W)."""
        return np.asarray(np.isfinite(self.values["u"]) & np.isfinite(self.values["v"]))

    def called(self, name: str) -> str:
        """Name with its unit, as programs show it."""
        return f"{name} [{self.units[name]}]" if self.units.get(name) else name


def read_vectors(path: Path) -> VectorTable:
    """Read a NetCDF file of vectors.

    Raises
    ------
    RunUsageError
        It is not there, damaged, or not one of vectors on a grid.
    """
    try:
        if path.stat().st_size > LARGEST:
            raise RunUsageError(f"{path}: larger than {LARGEST >> 30} GiB; export its parts")
        with scipy.io.netcdf_file(path, "r", mmap=False) as file:
            found = {name: (one.dimensions, np.array(one[:]), _text(one)) for name, one in file.variables.items()}
            title = _decoded(getattr(file, "title", path.stem))
    except OSError as error:
        raise RunUsageError(f"{path}: cannot be read: {error.strerror or error}") from None
    except DAMAGE:
        raise RunUsageError(f"{path}: is not a NetCDF file of vectors, or damaged") from None
    return _table(path, title, found)


def _table(path: Path, title: str, found: dict[str, tuple[tuple[str, ...], NDArray[Any], str]]) -> VectorTable:
    if not all(name in found and set(found[name][0]) == set(GRID) for name in "uv"):
        raise RunUsageError(f"{path}: has no u and v on a grid; traced and tracked vectors lie on none")
    axes = {name: found[name][1].astype(np.float64) for name in GRID if name in found}
    if len(axes) < len(GRID) or any(not np.isfinite(axis).all() or axis.ndim != 1 for axis in axes.values()):
        raise RunUsageError(f"{path}: says not where its vectors lie")
    shape = tuple(len(axes[name]) for name in GRID)
    values, units = {}, {}
    for name, (dimensions, numbers, unit) in found.items():
        if name in GRID or not set(dimensions) <= set(GRID) or numbers.dtype.kind not in "iuf":
            continue
        order = sorted(range(len(dimensions)), key=lambda place: GRID.index(dimensions[place]))
        spread = numbers.transpose(order).astype(np.float64)
        for place, axis in enumerate(GRID):
            if axis not in dimensions:
                spread = np.expand_dims(spread, place)
        try:
            values[name] = np.ascontiguousarray(np.broadcast_to(spread, shape))
        except ValueError:
            raise RunUsageError(f"{path}: {name} does not fit the grid; the file is damaged") from None
        units[name] = unit
    return VectorTable(title, axes["x"], axes["y"], axes["t"], values, units)


def _text(variable: Any) -> str:  # noqa: ANN401 - the library has no types
    return _decoded(getattr(variable, "units", ""))


def _decoded(said: Any) -> str:  # noqa: ANN401 - as the file has it
    text = said.decode("utf-8", "replace") if isinstance(said, bytes) else str(said)
    return "".join(letter for letter in text if letter.isprintable() and letter != '"')
