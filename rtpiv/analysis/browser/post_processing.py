"""Post-processing by choice: vectors beyond limits are left out or replaced.

Three criteria, each optional; a vector that fails any of them is an outlier:

    limits            u and v lie between two values (a rectangle in the scatter plot of u and v)
    deviations        |u - mean(u)| <= n std(u), and v likewise, over the vectors within the limits
    local median      normalised residual of the 5 x 5 neighbourhood (Westerweel, Scarano, Exp. Fluids 39, 1096
                      (2005)), with the median of the stated random uncertainty as the noise level

rtpiv has rejected outliers before, by the last of them; more are rejected here because a person wants it so, and
the file says which criteria that were.
"""

import json
from dataclasses import asdict, dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, ConfigDict, Field, with_config

from piv.correlation.outliers import outliers
from piv.correlation.planes import fill_gaps
from piv.correlation.vector_field import VectorFlag
from piv.files.vector_file import Vectors

NOISE_OF_RMS = 0.01  # noise level where no uncertainty is stated, over the rms of the vectors
# Fields of a vector that are kept where it is rejected or replaced: how it was measured, not what
KEPT_FIELDS = (
    "chc",
    "flag",
    "correlation",
    "peak_ratio",
    "valid_fraction",
    "map_sigma_x",
    "map_sigma_y",
    "count",
)
Number = Annotated[float, Field(gt=-1e300, lt=1e300)]
Place = tuple[Number, Number]


def _rise(limits: Place) -> Place:
    if not limits[0] < limits[1]:
        raise ValueError("limits are two numbers, the smaller one first")
    return limits


Limits = Annotated[Place, AfterValidator(_rise)]


@with_config(ConfigDict(extra="forbid"))
@dataclass(frozen=True)
class PostProcessing:
    """Criteria for vectors to keep, and what becomes of the others.

    Parameters
    ----------
    u_limits, v_limits : (float, float), optional
        Smallest and largest component, in the unit of the file.
    deviations : float, optional
        Largest distance from the mean of the field, in standard deviations of each component.
    local_median : float, optional
        Largest normalised residual against the neighbours; 2 to 3 are usual.
    interpolate : bool
        Replace rejected vectors by the plane through their neighbours, where there are at least three; otherwise
        they are left out.
    """

    u_limits: Limits | None = None
    v_limits: Limits | None = None
    deviations: Annotated[Number, Field(gt=0.0)] | None = None
    local_median: Annotated[Number, Field(gt=0.0)] | None = None
    interpolate: bool = False


def find_outliers(vectors: Vectors, time: int, chosen: PostProcessing) -> NDArray[np.bool_]:
    """Return the vectors of one time that fail the criteria.

    Parameters
    ----------
    vectors : Vectors
        Of a file.
    time : int
        Number of the time.
    chosen : PostProcessing
        Criteria.

    Returns
    -------
    ndarray of bool, shape (ny, nx)
        True where a measured vector is rejected.
    """
    uv = _components(vectors, time)
    kept = measured = np.asarray(vectors.measured[time])
    for along, limits in enumerate((chosen.u_limits, chosen.v_limits)):
        if limits is not None:
            kept = kept & (uv[..., along] >= limits[0]) & (uv[..., along] <= limits[1])
    if chosen.deviations is not None and kept.any():
        mean, std = uv[kept].mean(axis=0), uv[kept].std(axis=0)
        kept = kept & (np.abs(uv - mean) <= chosen.deviations * std).all(axis=-1)
    if chosen.local_median is not None and kept.any():
        kept = kept & ~outliers(uv, kept, chosen.local_median, _noise(vectors, time, uv[kept]))
    return np.asarray(measured & ~kept)


def post_process(vectors: Vectors, chosen: PostProcessing) -> Vectors:
    """Return the vectors with the outliers of every time left out or replaced.

    Uncertainties and what is derived from a rejected vector become NaN; the flag of a file of pairs says
    `REJECTED` or `REPLACED`, and the attribute ``post_processing`` states the criteria.

    Parameters
    ----------
    vectors : Vectors
        Of a file.
    chosen : PostProcessing
        Criteria.
    """
    fields = {name: np.array(values) for name, values in vectors.fields.items()}
    for time in range(len(vectors.times)):
        rejected = find_outliers(vectors, time, chosen)
        if not rejected.any():
            continue
        kept = np.asarray(vectors.measured[time]) & ~rejected
        filled = np.full((*kept.shape, 2), np.nan)
        if chosen.interpolate and kept.any():
            filled, near = fill_gaps(np.where(kept[..., None], _components(vectors, time), 0.0), kept)
            filled[~near] = np.nan
        for name, values in fields.items():
            if name not in KEPT_FIELDS and values.dtype.kind == "f":
                values[time][rejected] = np.nan
        for along, name in enumerate("uv"):
            fields[name][time][rejected] = filled[rejected, along]
        interpolated = rejected & np.isfinite(filled).all(axis=-1)
        if "flag" in fields:
            fields["flag"][time][rejected] = VectorFlag.REJECTED
            fields["flag"][time][interpolated] = VectorFlag.REPLACED
        if "chc" in fields:
            fields["chc"][time][rejected] = 0
    said = json.dumps({name: value for name, value in asdict(chosen).items() if value is not None})
    return replace(vectors, fields=fields, attributes={**vectors.attributes, "post_processing": said})


def _components(vectors: Vectors, time: int) -> NDArray[np.float64]:
    """Components (ny, nx, 2) of one time; 0 where there is no vector."""
    stacked = np.stack([vectors.fields[name][time] for name in "uv"], axis=-1).astype(np.float64)
    return np.where(np.asarray(vectors.measured[time])[..., None], stacked, 0.0)


def _noise(vectors: Vectors, time: int, uv: NDArray[np.float64]) -> float:
    """Noise level of a component: the median of its stated random uncertainty, in the unit of the file."""
    stated = np.concatenate(
        [np.ravel(vectors.fields[name][time]) for name in ("sigma_u", "sigma_v") if name in vectors.fields]
        or [np.empty(0)]
    )
    stated = stated[np.isfinite(stated) & (stated > 0.0)]
    rms = float(np.sqrt(np.mean(np.square(uv))))
    return float(np.median(stated)) if stated.size else max(NOISE_OF_RMS * rms, np.finfo(float).tiny)
