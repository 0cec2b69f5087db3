"""Vectors of a chunk on disk: NetCDF (classic, 64-bit offsets) with a time axis, as PIVPy and xarray read it.

Dimensions (t, y, x); coordinates x, y in mm on the plane, y UP and both rising, t in s since the first pair of the
run (or pairs, for a camera without a clock).  By pair and place:

    u, v                          velocity [m s-1], NaN where there is none
    displacement_x, _y            what it was made from, y up [px of the corrected image]
    sigma_u, sigma_v              random standard uncertainty of u, v (correlation statistics)
    resolution                    standard uncertainty of u and of v by what windows do not resolve [m s-1]
    correlation, chc, flag        coefficient of the peak; 1 = measured; VectorFlag

By pair: delta_t and sigma_delta_t [s] (NaN: nobody measured it), failed (1 = no vectors: `failures` says why),
static_share (of the light that does not move).  The error of delta_t is one factor for a whole pair and is not in
sigma_u; that of the fitted map is the same in all pairs and stands with their mean.
"""

import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.grid import PlaneGrid
from daq.errors import DiskError
from daq.whole_text import sync_folder, why
from ground.whole_file import whole_file
from piv.correlation.vector_field import VectorField, VectorFlag
from piv.correlation.windows import WindowGrid
from rtpiv.analysis.series.series_plan import SeriesPair

SCHEMA = 1
UNITS = {
    "u": "m s-1", "v": "m s-1", "sigma_u": "m s-1", "sigma_v": "m s-1", "resolution": "m s-1",
    "displacement_x": "pixel", "displacement_y": "pixel", "correlation": "1",
}  # fmt: skip
NAMES = {
    "x": "projection_x_coordinate", "y": "projection_y_coordinate", "t": "time", "u": "u_velocity",
    "v": "v_velocity", "chc": "validity_flag",
}  # fmt: skip
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PairResult:
    """What became of a pair: its vectors, or the reason why there are none."""

    pair: SeriesPair
    found: VectorField | str


@dataclass(frozen=True, eq=False)
class SeriesField:
    """Vectors of one pair as the file of its chunk has them: rows from the lowest y up.

    Parameters
    ----------
    tag : str
        Names the pair within its run.
    time_s : float
        Since the first pair of the run; its number there if the camera has no clock.
    dt_s, dt_sigma_s : float
        Time between its frames and the standard deviation of that, NaN if nobody measured it.
    velocity_m_s, sigma_m_s : (ny, nx, 2) float64
        u to the right and v UP, and their random standard uncertainty.
    resolution_m_s : (ny, nx) float64
        Standard uncertainty of u and of v by what windows do not resolve; NaN where not known.
    displacement_px : (ny, nx, 2) float64
        The same in pixels of the corrected image, y up.
    flags : (ny, nx) uint8
        VectorFlag.
    correlation : (ny, nx) float64
        Coefficient of the peak.
    static_share : float
        Share of the light that does not move; NaN where not known.
    failure : str
        Why there are no vectors; "" if there are.
    """

    tag: str
    time_s: float
    dt_s: float
    dt_sigma_s: float
    velocity_m_s: Floats
    sigma_m_s: Floats
    resolution_m_s: Floats
    displacement_px: Floats
    flags: NDArray[np.uint8]
    correlation: Floats
    static_share: float
    failure: str

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Measured vectors (ny, nx)."""
        return np.asarray(self.flags == VectorFlag.VALID)

    @property
    def valid_share(self) -> float:
        """Measured vectors of those outside the mask, 0 to 1."""
        return float(self.valid.sum() / max(int((self.flags != VectorFlag.MASKED).sum()), 1))


@dataclass(frozen=True, eq=False)
class ChunkContent:
    """A chunk's file as it was read.

    Parameters
    ----------
    x_mm, y_mm : (nx,), (ny,) float64
        Places on the plane, both rising.
    px_per_mm : float
        Scale of the corrected image.
    window_px, step_px : int
        Side and spacing of the windows.
    fields : tuple of SeriesField
        One a pair, in order.
    """

    x_mm: Floats
    y_mm: Floats
    px_per_mm: float
    window_px: int
    step_px: int
    fields: tuple[SeriesField, ...]


def write_chunk(
    path: Path, results: Sequence[PairResult], windows: WindowGrid, grid: PlaneGrid, about: dict[str, Any]
) -> bytes:
    """Write the file of a chunk, atomically, even if others do; return its bytes.

    Parameters
    ----------
    path : Path
        Final name.
    results : sequence of PairResult
        Its pairs in order.
    windows : WindowGrid
        Where vectors lie on the corrected image.
    grid : PlaneGrid
        Its scale and origin.
    about : dict
        Global attributes, str, int or float.

    Raises
    ------
    DiskError
        It cannot be written.
    """
    x_mm = grid.origin_mm[0] + windows.x_px * grid.pitch_mm
    y_mm = (grid.origin_mm[1] - windows.y_px * grid.pitch_mm)[::-1]
    times = [result.pair.time_s for result in results]
    has_clock = all(time is not None for time in times)
    numbers = [int(result.pair.tag.rsplit("_", 1)[-1]) // 2 for result in results] if not has_clock else []
    buffer = io.BytesIO()
    with scipy.io.netcdf_file(buffer, "w", version=2) as file:
        for name, size in (("t", len(results)), ("y", len(y_mm)), ("x", len(x_mm))):
            file.createDimension(name, size)
        when = times if has_clock else numbers
        for name, values, unit in (
            ("t", when, "s" if has_clock else "pair"),
            ("y", y_mm, "mm"),
            ("x", x_mm, "mm"),
        ):
            axis = file.createVariable(name, "f8", (name,))
            axis[:], axis.units, axis.standard_name, axis.axis = values, unit, NAMES[name], name.upper()
        for name, values in _by_pair(results).items():
            variable = file.createVariable(name, values.dtype.str[1:], ("t",))
            variable[:], variable.units = values, "s" if name.endswith("delta_t") else "1"
        fields = [_by_place(result, windows.shape, grid.pitch_mm) for result in results]
        for name in fields[0]:
            kind = "i1" if name in ("chc", "flag") else "f4"
            variable = file.createVariable(name, kind, ("t", "y", "x"))
            for place, field in enumerate(fields):
                variable[place] = field[name]
            variable.units = UNITS.get(name, "1")
            if name in NAMES:
                variable.standard_name = NAMES[name]
        file.Conventions = "CF-1.8"
        file.pivpy_schema_version = SCHEMA
        file.delta_t = np.float64(np.mean([result.pair.dt_s for result in results]))
        file.px_per_mm, file.window_px, file.step_px = grid.px_per_mm, windows.size_px, windows.step_px
        file.flag_meanings = ", ".join(f"{flag.value} {flag.name.lower()}" for flag in VectorFlag)
        file.pairs = json.dumps([result.pair.tag for result in results])
        file.failures = json.dumps([r.found if isinstance(r.found, str) else "" for r in results])
        for name, value in about.items():
            setattr(file, name, value)
        file.flush()
        content = buffer.getvalue()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path, among_many=True) as stream:
            stream.write(content)
        sync_folder(path.parent)
    except OSError as error:
        raise DiskError(f"{path}: {why(error)}; make room, then give the same command again") from error
    return content


def read_chunk(content: bytes) -> ChunkContent:
    """Read the bytes of a chunk's file, which its marker has vouched for."""
    with scipy.io.netcdf_file(io.BytesIO(content), "r", mmap=False) as file:
        found: dict[str, NDArray[Any]] = {name: np.array(variable[:]) for name, variable in file.variables.items()}
        tags, failures = (json.loads(getattr(file, name)) for name in ("pairs", "failures"))
        scale = (float(file.px_per_mm), int(file.window_px), int(file.step_px))

    def both(place: int, *names: str) -> Floats:
        return np.stack([found[name][place] for name in names], axis=-1).astype(np.float64)

    unresolved = found.get("resolution", np.full_like(found["u"], np.nan))  # before it was stored
    fields = tuple(
        SeriesField(
            tag,
            float(found["t"][place]),
            float(found["delta_t"][place]),
            float(found["sigma_delta_t"][place]),
            both(place, "u", "v"),
            both(place, "sigma_u", "sigma_v"),
            unresolved[place].astype(np.float64),
            both(place, "displacement_x", "displacement_y"),
            found["flag"][place].astype(np.uint8),
            found["correlation"][place].astype(np.float64),
            float(found["static_share"][place]),
            failures[place],
        )
        for place, tag in enumerate(tags)
    )
    return ChunkContent(found["x"].astype(np.float64), found["y"].astype(np.float64), *scale, fields)


def _by_pair(results: Sequence[PairResult]) -> dict[str, NDArray[Any]]:
    fields = [None if isinstance(result.found, str) else result.found for result in results]
    sigma = [np.nan if result.pair.dt_sigma_s is None else result.pair.dt_sigma_s for result in results]
    return {
        "delta_t": np.array([result.pair.dt_s for result in results]),
        "sigma_delta_t": np.array(sigma),
        "failed": np.array([field is None for field in fields], np.int8),
        "static_share": np.array([np.nan if f is None else f.static_share for f in fields], np.float32),
    }


def _by_place(result: PairResult, shape: tuple[int, int], pitch_mm: float) -> dict[str, NDArray[Any]]:
    """Variables (ny, nx) of a pair, rows from the lowest y up."""
    field, m_s_per_px = result.found, 1e-3 * pitch_mm / result.pair.dt_s
    nothing = np.full(shape, np.nan)
    if isinstance(field, str):
        masked, nobody = np.full(shape, VectorFlag.MASKED, np.int8), np.zeros(shape, np.int8)
        return dict.fromkeys(UNITS, nothing) | {"chc": nobody, "flag": masked}
    values = {
        "u": field.u_px * m_s_per_px,
        "v": -field.v_px * m_s_per_px,
        "sigma_u": field.sigma_u_px * m_s_per_px,
        "sigma_v": field.sigma_v_px * m_s_per_px,
        "resolution": nothing if field.resolution_px is None else field.resolution_px * m_s_per_px,
        "displacement_x": field.u_px,
        "displacement_y": -field.v_px,
        "correlation": field.correlation,
        "chc": field.valid.astype(np.int8),
        "flag": field.flags.astype(np.int8),
    }
    return {name: np.asarray(each)[::-1] for name, each in values.items()}
