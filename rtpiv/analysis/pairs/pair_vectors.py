"""Vectors of pairs as one dataset (t, y, x), and back: a series of pairs, or one.

By pair and place:

    u, v                          velocity [m s-1], or displacement [mm] where the time between the frames is not
                                  known; NaN where there is none
    displacement_x, _y            what it was made from, y up [px of the corrected image]
    sigma_u, sigma_v              random standard uncertainty of u, v (correlation statistics)
    resolution                    standard uncertainty of u and of v by what windows do not resolve
    resolution_steady             the part of it that is the same in every pair of a steady flow
    unfiltered_u, _v              u, v before the noise filter, where measured; with unfiltered_sigma, the random
                                  standard uncertainty of a component, and unfiltered_steady, their
                                  resolution_steady: means are made of these (`piv.statistics.denoised_mean`);
                                  missing without a noise filter, and in files of older versions
    usual_window                  with these: 1 where the vector comes from a window of `window_px`, 0 of a smaller
    correlation, chc, flag        coefficient of the peak; 1 = measured; VectorFlag

By pair: delta_t and sigma_delta_t [s] (NaN: not known, not measured), failed (1 = no vectors: `failures` says
why), static_share (of the light that does not move).  The error of delta_t is one factor for a whole pair and is
not in sigma_u; that of the fitted map is the same in all pairs and stands with their mean, or beside the vectors
of a pair that is evaluated alone, with more of its quality:

    map_sigma_u, _v               standard uncertainty of u, v by the fitted map
    map_sigma_x, _y               that of the position by the fitted map [mm]
    slant_sigma_u, _v             standard uncertainty of u, v by the velocity w through the sheet (`out_of_plane`
                                  says what it is taken to be); missing where particles were moved by a known way
    total_sigma_u, _v             all of these that are known, as root sum of squares
    vorticity, divergence, shear, swirling_strength; sigma_vorticity ...
                                  of u, v [s-1], or of displacements [mm per mm] (`piv.statistics.derived`)
    peak_ratio, valid_fraction    of the highest peaks; share of valid pixels in the window

By place: dxdz, dydz, the slopes of the rays: measured are u - w dxdz, v - w dydz (`correction.maps.slant`).

t is in s since the first pair of the run, or counts pairs, for a camera without a clock.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.evaluate.particle_tracks import PlaneVectors
from correction.fitted.map_sigma import VectorMapSigma
from correction.grid import PlaneGrid
from daq.runs.run_views import length_unit
from piv.correlation.vector_field import VectorField, VectorFlag, could_be_measured
from piv.correlation.windows import WindowGrid
from piv.errors import SeriesError
from piv.files.vector_file import LENGTH, PIXELS, SPEED, Vectors, read_vectors
from piv.statistics.derived import PlaneField, rates
from rtpiv.analysis.pairs.slanted import Slanted
from tracer.scene.scene import Scene

UNFILTERED = (
    "unfiltered_u",
    "unfiltered_v",
    "unfiltered_sigma",
    "unfiltered_steady",
)
USUAL = "usual_window"
PER_TIME = (  # in m/s, or in mm
    *UNFILTERED,
    "u",
    "v",
    "sigma_u",
    "sigma_v",
    "resolution",
    "resolution_steady",
    "map_sigma_u",
    "map_sigma_v",
    "slant_sigma_u",
    "slant_sigma_v",
    "total_sigma_u",
    "total_sigma_v",
)
UNITS = {
    "displacement_x": "pixel",
    "displacement_y": "pixel",
    "delta_t": "s",
    "sigma_delta_t": "s",
    "x": LENGTH,
    "y": LENGTH,
    "map_sigma_x": LENGTH,
    "map_sigma_y": LENGTH,
}
RATE, ONE = "s-1", "1"
RATES = ("vorticity", "divergence", "shear", "swirling_strength")
SLOPES = ("dxdz", "dydz")
MEASURED = (
    "u",
    "v",
    "sigma_u",
    "sigma_v",
    "resolution",
    "resolution_steady",
    "displacement_x",
    "displacement_y",
    "correlation",
    *UNFILTERED,
)
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PairResult:
    """Result of a pair.

    Parameters
    ----------
    tag : str
        Names the pair within its run.
    found : VectorField or str
        Its vectors, or the reason why there are none.
    dt_s, dt_sigma_s : float, optional
        Time between its frames, and the standard deviation of that.
    time_s : float, optional
        Since the first pair of the run; None if the camera has no clock.
    """

    tag: str
    found: VectorField | str
    dt_s: float | None = None
    dt_sigma_s: float | None = None
    time_s: float | None = None


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
        Time between its frames and the standard deviation of that, NaN if it was not measured.
    velocity_m_s, sigma_m_s : (ny, nx, 2) float64
        u to the right and v UP, and their random standard uncertainty.
    resolution_m_s : (ny, nx) float64
        Standard uncertainty of u and of v by what windows do not resolve; NaN where not known.
    steady_m_s : (ny, nx) float64
        The part of it that is the same in every pair of a steady flow.
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
    unfiltered_m_s : (ny, nx, 4) float64, optional
        Vectors before the noise filter, random standard uncertainty of a component, and its part `steady_m_s`;
        None where the file has none.
    is_usual : (ny, nx) bool, optional
        With these: vectors from windows of usual size.
    """

    tag: str
    time_s: float
    dt_s: float
    dt_sigma_s: float
    velocity_m_s: Floats
    sigma_m_s: Floats
    resolution_m_s: Floats
    steady_m_s: Floats
    displacement_px: Floats
    flags: NDArray[np.uint8]
    correlation: Floats
    static_share: float
    failure: str
    unfiltered_m_s: Floats | None = None
    is_usual: NDArray[np.bool_] | None = None

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Measured vectors (ny, nx)."""
        return np.asarray(self.flags == VectorFlag.VALID)

    @property
    def valid_share(self) -> float:
        """Measured vectors of those outside the mask, 0 to 1."""
        return float(self.valid.sum() / max(int(could_be_measured(self.flags).sum()), 1))


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


def vectors_of_pairs(
    results: Sequence[PairResult],
    windows: WindowGrid,
    grid: PlaneGrid,
    about: Mapping[str, Any],
    more: Mapping[str, NDArray[Any]] | None = None,
    slope: Floats | None = None,
) -> Vectors:
    """Vectors of pairs as one dataset.

    Parameters
    ----------
    results : sequence of PairResult
        Pairs in order.
    windows : WindowGrid
        Where vectors lie on the corrected image.
    grid : PlaneGrid
        Its scale and origin.
    about : dict
        Attributes, str, int or float.
    more : mapping of str to (T, ny, nx), optional
        Further fields, see `quality_of`.
    slope : (ny, nx, 2) float64, optional
        dX/dz, dY/dz of the rays, rows from the top of the image, y up.

    Returns
    -------
    Vectors
        In m/s if the time between the frames of every pair is known, else in mm, or in pixels where `about` says
        so (`length_unit`).
    """
    timed = all(result.dt_s is not None for result in results)
    clock = [result.time_s for result in results if result.time_s is not None]
    has_clock = len(clock) == len(results)
    fields = [_by_place(result, windows.shape, grid.pitch_mm, timed) for result in results]
    names = [
        name
        for name in fields[0]
        if name not in (*UNFILTERED, USUAL) or any(_has_unfiltered(each) for each in results)
    ]
    attributes: dict[str, Any] = {
        "delta_t": np.float64(np.mean([result.dt_s for result in results]) if timed else 0.0),
        "px_per_mm": grid.px_per_mm,
        "window_px": windows.size_px,
        "step_px": windows.step_px,
        "pairs": json.dumps([result.tag for result in results]),
        "failures": json.dumps([r.found if isinstance(r.found, str) else "" for r in results]),
    }
    return Vectors(
        x_mm=grid.origin_mm[0] + windows.x_px * grid.pitch_mm,
        y_mm=(grid.origin_mm[1] - windows.y_px * grid.pitch_mm)[::-1],
        times=np.array(clock if has_clock else _numbers(results), np.float64),
        fields={name: np.stack([field[name] for field in fields]) for name in names} | dict(more or {}),
        by_time=_by_pair(results),
        units=_units(timed, str(about.get("length_unit", LENGTH))),
        attributes=attributes | dict(about),
        time_unit="s" if has_clock else "pair",
        by_place={} if slope is None else dict(zip(SLOPES, np.moveaxis(slope[::-1], -1, 0), strict=True)),
    )


def _has_unfiltered(result: PairResult) -> bool:
    field = result.found
    return not isinstance(field, str) and field.unfiltered_px is not None


def _units(timed: bool, length: str) -> dict[str, str]:
    rates = [f"{before}{name}" for name in RATES for before in ("", "sigma_")]
    of_time = dict.fromkeys(PER_TIME, SPEED if timed else length)
    of_place = {name: length if unit == LENGTH else unit for name, unit in UNITS.items()}
    return of_place | of_time | dict.fromkeys(rates, RATE if timed else ONE)


def quality_of(
    field: VectorField,
    grid: PlaneGrid,
    total_sigma_px: Floats,
    map_sigma: VectorMapSigma | None = None,
    dt_s: float | None = None,
    slant: Slanted | None = None,
) -> dict[str, NDArray[Any]]:
    """Fields (1, ny, nx) of a pair that is evaluated alone, beside its vectors; see the top of this file."""
    found: dict[str, NDArray[Any]] = {"peak_ratio": field.peak_ratio, "valid_fraction": field.valid_fraction}
    for number, along in enumerate("uv"):
        found[f"total_sigma_{along}"] = total_sigma_px[..., number] * per_px(grid.pitch_mm, dt_s)
        if slant is not None:
            found[f"slant_sigma_{along}"] = slant.sigma_px[..., number] * per_px(grid.pitch_mm, dt_s)
    if map_sigma is not None:
        for number, (along, place) in enumerate((("u", "x"), ("v", "y"))):
            found[f"map_sigma_{along}"] = map_sigma.displacement_px[..., number] * per_px(grid.pitch_mm, dt_s)
            found[f"map_sigma_{place}"] = map_sigma.position_px[..., number] * grid.pitch_mm
    return {name: values[::-1][None] for name, values in (found | _rates_of(field, grid, dt_s, slant)).items()}


def _rates_of(
    field: VectorField, grid: PlaneGrid, dt_s: float | None, slant: Slanted | None
) -> dict[str, NDArray[Any]]:
    """Rates of a pair (ny, nx), rows from the top of the image: per s, or of displacements."""
    scale = per_px(grid.pitch_mm, dt_s)
    uv = np.stack((field.u_px, -field.v_px), axis=-1)[::-1] * scale
    x_mm, y_mm = grid.pitch_mm * field.x_px, -grid.pitch_mm * field.y_px[::-1]
    alike_mm = 0.5 * field.window_px * grid.pitch_mm
    through = None if slant is None else slant.through.upside_down.times(scale)
    plane = PlaneField(x_mm, y_mm, uv, field.total_sigma_px[::-1] * scale, alike_mm, through)
    per_s = 1.0 if dt_s is None else 1e3  # m/s per mm
    found: dict[str, NDArray[Any]] = {}
    for name, (value, sigma) in rates(plane).items():
        found[name], found[f"sigma_{name}"] = per_s * value[::-1], per_s * sigma[::-1]
    return found


def columns_of(tracks: PlaneVectors, dt_s: float | None) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
    """Columns of vectors that lie on no grid, x, y, u, v, their sigma and branch, and the units of these."""
    per_mm = per_px(1.0, dt_s)
    columns: dict[str, NDArray[Any]] = {"x": tracks.place_mm[:, 0], "y": tracks.place_mm[:, 1]}
    for number, name in enumerate("uv"):
        columns[name] = (tracks.shift_mm[:, number] * per_mm).astype(np.float32)
        columns[f"sigma_{name}"] = (tracks.sigma_mm[:, number] * per_mm).astype(np.float32)
    columns["branch"] = tracks.branch.astype(np.int32)
    return columns, UNITS | dict.fromkeys(PER_TIME, LENGTH if dt_s is None else SPEED)


def join_vectors(parts: Sequence[Vectors]) -> Vectors:
    """Vectors of pairs one after the other, with the fields that all of them have.

    Raises
    ------
    SeriesError
        They lie on different grids.
    """
    first = parts[0]
    if len(parts) == 1:
        return first
    for part in parts:
        if not (np.array_equal(part.x_mm, first.x_mm) and np.array_equal(part.y_mm, first.y_mm)):
            raise SeriesError("these pairs lie on different grids; look at them one by one")
    names = [name for name in first.fields if all(name in part.fields for part in parts)]
    lists = {
        name: json.dumps([one for part in parts for one in json.loads(part.attributes[name])])
        for name in ("pairs", "failures")
    }
    times = np.concatenate([part.times for part in parts])
    if first.time_unit != "s" and len(np.unique(times)) < len(times):  # each counts from its own first pair
        times = np.arange(len(times), dtype=np.float64)
    return replace(
        first,
        times=times,
        fields={name: np.concatenate([part.fields[name] for part in parts]) for name in names},
        by_time={name: np.concatenate([part.by_time[name] for part in parts]) for name in first.by_time},
        attributes={**first.attributes, **lists},
    )


def read_chunk(content: bytes) -> ChunkContent:
    """Read the bytes of a chunk's file, which its marker has vouched for; VectorFileError if they are none."""
    vectors = read_vectors(content)
    said = vectors.attributes
    tags, failures = (json.loads(said[name]) for name in ("pairs", "failures"))

    def both(place: int, *names: str) -> Floats:
        return np.stack([vectors.fields[name][place] for name in names], axis=-1).astype(np.float64)

    unresolved = vectors.fields.get(
        "resolution", np.full_like(vectors.fields["u"], np.nan)
    )  # before it was stored
    steady = vectors.fields.get("resolution_steady", unresolved)
    has_unfiltered = all(name in vectors.fields for name in (*UNFILTERED, USUAL))
    fields = tuple(
        SeriesField(
            tag,
            float(vectors.times[place]),
            float(vectors.by_time["delta_t"][place]),
            float(vectors.by_time["sigma_delta_t"][place]),
            both(place, "u", "v"),
            both(place, "sigma_u", "sigma_v"),
            unresolved[place].astype(np.float64),
            steady[place].astype(np.float64),
            both(place, "displacement_x", "displacement_y"),
            vectors.fields["flag"][place].astype(np.uint8),
            vectors.fields["correlation"][place].astype(np.float64),
            float(vectors.by_time["static_share"][place]),
            failures[place],
            both(place, *UNFILTERED) if has_unfiltered else None,
            vectors.fields[USUAL][place] == 1 if has_unfiltered else None,
        )
        for place, tag in enumerate(tags)
    )
    scale = float(said["px_per_mm"]), int(said["window_px"]), int(said["step_px"])
    return ChunkContent(vectors.x_mm, vectors.y_mm, *scale, fields)


def _numbers(results: Sequence[PairResult]) -> list[int]:
    """Numbers of pairs without a clock: from the frame in their tags, or in order."""
    ends = [result.tag.rpartition("_")[2] for result in results]
    return [int(end) // 2 for end in ends] if all(end.isdecimal() for end in ends) else list(range(len(ends)))


def lengths_said(scene: Scene) -> dict[str, str]:
    """Return the attribute of a file whose lengths are pixels; nothing where they are mm."""
    return {"length_unit": PIXELS} if length_unit(scene) == "px" else {}


def per_px(pitch_mm: float, dt_s: float | None) -> float:
    """Velocity [m/s] of 1 px, or its length [mm] where the time is not known."""
    return pitch_mm if dt_s is None else 1e-3 * pitch_mm / dt_s


def _by_pair(results: Sequence[PairResult]) -> dict[str, NDArray[Any]]:
    fields = [None if isinstance(result.found, str) else result.found for result in results]

    def times(each: Sequence[float | None]) -> Floats:
        return np.array([np.nan if time is None else time for time in each])

    return {
        "delta_t": times([result.dt_s for result in results]),
        "sigma_delta_t": times([result.dt_sigma_s for result in results]),
        "failed": np.array([field is None for field in fields], np.int8),
        "static_share": np.array([np.nan if f is None else f.static_share for f in fields], np.float32),
    }


def _by_place(result: PairResult, shape: tuple[int, int], pitch_mm: float, timed: bool) -> dict[str, NDArray[Any]]:
    """Fields (ny, nx) of a pair, rows from the lowest y up."""
    field, scale = result.found, per_px(pitch_mm, result.dt_s if timed else None)
    nothing = np.full(shape, np.nan)
    if isinstance(field, str):
        masked, none = np.full(shape, VectorFlag.MASKED, np.int8), np.zeros(shape, np.int8)
        return dict.fromkeys(MEASURED, nothing) | {"chc": none, "flag": masked, USUAL: none}
    usual = np.ones(shape, np.bool_) if field.side_px is None else field.side_px == field.window_px
    lengths = field.lengths
    rough = lengths.get("unfiltered_px", np.full((*shape, 2), np.nan))
    values = {
        "u": field.u_px * scale,
        "v": -field.v_px * scale,
        "sigma_u": field.sigma_u_px * scale,
        "sigma_v": field.sigma_v_px * scale,
        "resolution": lengths.get("resolution_px", nothing) * scale,
        "resolution_steady": lengths.get("steady_px", nothing) * scale,
        "unfiltered_u": rough[..., 0] * scale,
        "unfiltered_v": -rough[..., 1] * scale,
        "unfiltered_sigma": lengths.get("unfiltered_sigma_px", nothing) * scale,
        "unfiltered_steady": lengths.get("unfiltered_steady_px", nothing) * scale,
        USUAL: usual.astype(np.int8),
        "displacement_x": field.u_px,
        "displacement_y": -field.v_px,
        "correlation": field.correlation,
        "chc": field.valid.astype(np.int8),
        "flag": field.flags.astype(np.int8),
    }
    return {name: np.asarray(each)[::-1] for name, each in values.items()}
