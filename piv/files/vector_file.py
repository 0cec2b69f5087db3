"""Vectors on disk: one NetCDF file for programs, VTK text for pictures.

NetCDF is classic with 64-bit offsets, which everything reads.  Vectors on a grid have the dimensions (t, y, x),
with coordinates x and y in mm on the plane, y UP and both rising, so that row 0 is the lowest of the image.  `u`
and `v` are velocities in m/s where the time between the frames is known, else displacements in mm; `units` of
every variable and `standard_name` of the known ones say which.  Schema 2 (attribute ``rtpiv_schema``) is the first
in which one pair, a series of pairs and their mean have one layout.  PIVPy and xarray read it as it is:
``pivpy_schema_version`` is that of PIVPy's own names.  Files of schema 1 are read as well: a pair lay as (y, x, t)
there, in mm/s.

Numbers on the grid are float32: 6e-8 of a value is a thousandth of what the best vector is unsure of, a long
series takes half the disk, and a mean is computed from what the files hold.  Places and times are float64.

Traced and tracked vectors lie on no grid; they are a list along the dimension `vector`.
"""

import io
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from ground.printable import utf8
from ground.whole_file import whole_file
from piv.correlation.vector_field import VectorFlag
from piv.errors import VectorFileError

SCHEMA = 2
PIVPY_SCHEMA = 1
GRID = ("t", "y", "x")
SPEED, LENGTH, PIXELS = "m s-1", "mm", "pixel"
KINDS = (set(GRID), {"t"}, {"y", "x"})  # dimensions of fields, of numbers by time, of numbers by place
STANDARD_NAMES = {
    "x": "projection_x_coordinate", "y": "projection_y_coordinate", "t": "time", "chc": "validity_flag",
}  # fmt: skip
LONG_NAMES = {
    "light_z": "height of the light over the plane, where the vectors are measured",
    "dxdz": "slope dX/dz of the rays at the plane", "dydz": "slope dY/dz of the rays at the plane",
    "slant_sigma_u": "standard uncertainty of u by the velocity through the sheet",
    "slant_sigma_v": "standard uncertainty of v by the velocity through the sheet",
}  # fmt: skip
VTK_TITLE_BYTES = 255  # in one line, of the legacy format
LARGEST = 1 << 31  # bytes of a file that is read
DAMAGE = (ValueError, TypeError, IndexError, KeyError, AttributeError, OverflowError, AssertionError, EOFError,
          MemoryError, NotImplementedError, struct.error)  # fmt: skip
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Variable:
    """A variable of a NetCDF file: along which dimensions it lies, its values, their unit, what else is said."""

    dimensions: tuple[str, ...]
    values: NDArray[Any]
    unit: str = "1"
    more: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Vectors:
    """Vectors of T times on a grid of the plane, rows from the lowest y up, u to the right and v UP.

    Parameters
    ----------
    x_mm, y_mm : (nx,), (ny,) float64
        Places, both rising.
    times : (T,) float64
        In `time_unit`.
    fields : mapping of str to (T, ny, nx)
        By name, `u` and `v` among them; NaN where there is none.
    by_time : mapping of str to (T,)
        Numbers of a whole time, such as ``delta_t`` [s].
    by_place : mapping of str to (ny, nx)
        Numbers of a place that are the same at all times, such as the slopes of rays.
    units : mapping of str to str
        Of fields and numbers that have one.
    attributes : mapping of str to str, int or float
        What is said of all of them.
    time_unit : str
        "s", or "pair" where the camera has no clock.
    """

    x_mm: Floats
    y_mm: Floats
    times: Floats
    fields: Mapping[str, NDArray[Any]]
    by_time: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    attributes: Mapping[str, Any] = field(default_factory=dict)
    time_unit: str = "s"
    by_place: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    @property
    def measured(self) -> NDArray[np.bool_]:
        """True where there is a vector (T, ny, nx)."""
        return np.asarray(np.isfinite(self.fields["u"]) & np.isfinite(self.fields["v"]))

    @property
    def kind(self) -> str:
        """Quantity of u and v: "velocity", or "displacement" where they are lengths."""
        return "displacement" if self.units.get("u") in (LENGTH, PIXELS) else "velocity"

    @property
    def length_unit(self) -> str:
        """Unit of places: "mm", or "pixel" where no scale is given."""
        return str(self.attributes.get("length_unit", LENGTH))

    @property
    def everything(self) -> dict[str, NDArray[Any]]:
        """Fields, and the numbers of each time and of each place spread over the others (T, ny, nx)."""
        shape = (len(self.times), len(self.y_mm), len(self.x_mm))
        spread = {name: np.broadcast_to(one[:, None, None], shape) for name, one in self.by_time.items()}
        spread |= {name: np.broadcast_to(one, shape) for name, one in self.by_place.items()}
        return {**self.fields, **spread}

    def called(self, name: str) -> str:
        """Name with its unit, as programs show it."""
        return f"{name} [{self.units[name]}]" if self.units.get(name) else name

    def __repr__(self) -> str:
        """Say how many vectors of how many times, and what else there is."""
        shape = " x ".join(str(len(axis)) for axis in (self.times, self.y_mm, self.x_mm))
        names = ", ".join(self.called(name) for name in (*self.fields, *self.by_time, *self.by_place))
        return f"Vectors of {shape} (t, y, x), {int(self.measured.sum())} measured: {names}"

    def _repr_html_(self) -> str:
        """Show a notebook what there is, and the median of every field."""
        rows = []
        for name, values in self.fields.items():
            known = values[np.isfinite(values)]
            middle = f"{np.median(known):.4g}" if known.size else "-"
            rows.append(f"<tr><td>{escape(self.called(name))}</td><td>{known.size}</td><td>{middle}</td></tr>")
        shape = " x ".join(str(len(axis)) for axis in (self.times, self.y_mm, self.x_mm))
        head = "<tr><th></th><th>known</th><th>median</th></tr>"
        return f"<p>{self.kind} on {shape} (t, y, x)</p><table>{head}{''.join(rows)}</table>"


def netcdf(variables: Mapping[str, Variable], attributes: Mapping[str, Any]) -> bytes:
    """Return the bytes of a NetCDF file; dimensions are as long as the variables along them."""
    buffer = io.BytesIO()
    with scipy.io.netcdf_file(buffer, "w", version=2) as file:
        for one in variables.values():
            for name, size in zip(one.dimensions, one.values.shape, strict=True):
                if name not in file.dimensions:
                    file.createDimension(name, size)
        for name, one in variables.items():
            variable = file.createVariable(name, _kind(one.values), one.dimensions)
            variable[:] = one.values
            for what, said in {"units": one.unit, **one.more}.items():
                setattr(variable, what, utf8(said))
        for name, value in {"Conventions": "CF-1.8", **attributes}.items():
            setattr(file, name, utf8(value) if isinstance(value, str) else value)  # SciPy would take ASCII alone
        file.flush()
        return buffer.getvalue()


def _kind(values: NDArray[Any]) -> str:
    """Type in a classic NetCDF file, which has no unsigned numbers and no long ones."""
    if values.dtype.kind == "f":
        return f"f{values.dtype.itemsize}"
    return "i1" if values.dtype.itemsize == 1 else "i4"


def vectors_netcdf(vectors: Vectors) -> bytes:
    """Return the bytes of the NetCDF file of vectors on a grid."""
    names = STANDARD_NAMES | {name: f"{name}_{vectors.kind}" for name in "uvw"}

    def variable(name: str, dimensions: tuple[str, ...], values: NDArray[Any], unit: str) -> Variable:
        said = {"standard_name": names[name]} if name in names else {}
        said |= {"long_name": LONG_NAMES[name]} if name in LONG_NAMES else {}
        return Variable(dimensions, values, unit, said | ({"axis": name.upper()} if name in GRID else {}))

    unit = vectors.length_unit
    axes = (("t", vectors.times, vectors.time_unit), ("y", vectors.y_mm, unit), ("x", vectors.x_mm, unit))
    found = {name: variable(name, (name,), values, unit) for name, values, unit in axes}
    for name, values in vectors.by_time.items():
        found[name] = variable(name, ("t",), values, vectors.units.get(name, "1"))
    for dimensions, some in ((GRID, vectors.fields), (GRID[1:], vectors.by_place)):
        for name, values in some.items():
            stored = values.astype(np.float32) if values.dtype.kind == "f" else values
            found[name] = variable(name, dimensions, stored, vectors.units.get(name, "1"))
    meanings = ", ".join(f"{flag.value} {flag.name.lower()}" for flag in VectorFlag)
    about = {"rtpiv_schema": SCHEMA, "pivpy_schema_version": PIVPY_SCHEMA, "flag_meanings": meanings}
    return netcdf(found, about | dict(vectors.attributes))


def write_vectors(path: Path, vectors: Vectors) -> None:
    """Write vectors on a grid as NetCDF, atomically."""
    _write(path, vectors_netcdf(vectors))


def write_list(
    path: Path, columns: Mapping[str, NDArray[Any]], units: Mapping[str, str], attributes: Mapping[str, Any]
) -> None:
    """Write vectors that lie on no grid as NetCDF, atomically: columns of one length along `vector`."""
    found = {name: Variable(("vector",), one, units.get(name, "1")) for name, one in columns.items()}
    _write(path, netcdf(found, {"rtpiv_schema": SCHEMA, **attributes}))


def _write(path: Path, content: bytes) -> None:
    with whole_file(path) as stream:
        stream.write(content)


def read_vectors(source: Path | bytes) -> Vectors:
    """Read vectors on a grid from a file, or from its bytes; axes may lie in any order.

    Raises
    ------
    VectorFileError
        It is not there, damaged, or not one of vectors on a grid.
    """
    name = str(source) if isinstance(source, Path) else "these bytes"
    try:
        if isinstance(source, Path) and source.stat().st_size > LARGEST:
            raise VectorFileError(f"{name}: larger than {LARGEST >> 30} GiB; read its parts")
        opened = source if isinstance(source, Path) else io.BytesIO(source)
        with scipy.io.netcdf_file(opened, "r", mmap=False) as file:
            found = {
                one: Variable(each.dimensions, np.array(each[:]), _plain(getattr(each, "units", "")))
                for one, each in file.variables.items()
            }
            about = {one: _plain(value) for one, value in file._attributes.items()}
    except OSError as error:
        raise VectorFileError(f"{name}: cannot be read: {error.strerror or error}") from None
    except DAMAGE:
        raise VectorFileError(f"{name}: is not a NetCDF file of vectors, or damaged") from None
    return _on_grid(name, found, about)


def _on_grid(path: str, found: Mapping[str, Variable], about: Mapping[str, Any]) -> Vectors:
    if not all(name in found and set(found[name].dimensions) == set(GRID) for name in "uv"):
        raise VectorFileError(f"{path}: has no u and v on a grid; traced and tracked vectors lie on none")
    axes = {name: found[name].values.astype(np.float64) for name in GRID if name in found}
    if len(axes) < len(GRID) or any(not np.isfinite(axis).all() or axis.ndim != 1 for axis in axes.values()):
        raise VectorFileError(f"{path}: says not where its vectors lie")
    fields: dict[str, NDArray[Any]] = {}
    by_time: dict[str, NDArray[Any]] = {}
    by_place: dict[str, NDArray[Any]] = {}
    units: dict[str, str] = {}
    for name, one in found.items():
        if name in GRID or one.values.dtype.kind not in "iuf" or set(one.dimensions) not in KINDS:
            continue
        along = tuple(axis for axis in GRID if axis in one.dimensions)
        if tuple(one.values.shape[one.dimensions.index(axis)] for axis in along) != tuple(
            len(axes[axis]) for axis in along
        ):
            raise VectorFileError(f"{path}: {name} does not fit the grid; the file is damaged")
        values = one.values.transpose([one.dimensions.index(axis) for axis in along])
        native = np.ascontiguousarray(values, values.dtype.newbyteorder("="))  # NetCDF is big-endian
        (fields if along == GRID else by_time if along == GRID[:1] else by_place)[name] = native
        units[name] = one.unit
    return Vectors(axes["x"], axes["y"], axes["t"], fields, by_time, units, about, found["t"].unit, by_place)


def _plain(said: Any) -> Any:  # noqa: ANN401 - as the file has it
    """Text without what cannot be printed, or a number."""
    if isinstance(said, bytes):
        said = said.decode("utf-8", "replace")
    if isinstance(said, str):
        return "".join(letter for letter in said if letter.isprintable())
    return said.item() if isinstance(said, np.generic | np.ndarray) and said.size == 1 else said


def write_vtk(path: Path, vectors: Vectors) -> list[Path]:
    """Write a rectilinear grid for each time (``.vtk``, legacy text, NaN where there is no vector), atomically.

    Returns
    -------
    list of Path
        The files; those of several times are numbered, which is a series for ParaView.
    """
    count = len(vectors.times)
    written = []
    for number in range(count):
        name = path.with_suffix(".vtk") if count == 1 else path.with_name(f"{path.stem}_{number:05d}.vtk")
        _write(name, utf8("\n".join((*_vtk_lines(vectors, number), ""))))
        written.append(name)
    return written


def _vtk_lines(vectors: Vectors, number: int) -> Iterator[str]:
    title = str(vectors.attributes.get("title", "")) or f"rtpiv {vectors.called('u')}, {vectors.called('v')}"
    line = utf8(" ".join(title.split()))[:VTK_TITLE_BYTES].decode("utf-8", "ignore")
    yield from ("# vtk DataFile Version 3.0", line, "ASCII", "DATASET RECTILINEAR_GRID")
    yield f"DIMENSIONS {len(vectors.x_mm)} {len(vectors.y_mm)} 1"
    for letter, axis in (("X", vectors.x_mm), ("Y", vectors.y_mm), ("Z", np.zeros(1))):
        yield f"{letter}_COORDINATES {len(axis)} double"
        yield " ".join(f"{value:.9g}" for value in axis)
    yield f"POINT_DATA {vectors.measured[number].size}"
    yield f"VECTORS {vectors.kind} double"
    nothing = np.zeros_like(vectors.fields["u"])  # w of a single camera
    components = [vectors.fields.get(name, nothing)[number].ravel() for name in "uvw"]
    yield from (f"{u:.9g} {v:.9g} {w:.9g}" for u, v, w in zip(*components, strict=True))
    for name, values in vectors.everything.items():
        yield from (f"SCALARS {name} double 1", "LOOKUP_TABLE default")
        yield from (f"{value:.9g}" for value in values[number].ravel())
