"""Arrays of statistics that come from files or callers: of the names, shapes and kinds that they must have."""

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from piv.errors import SeriesError

Some = TypeVar("Some", bound=NDArray[Any])


def shaped(name: str, values: Some, shape: tuple[int, ...]) -> Some:
    """The same array; SeriesError if it has another shape."""
    if values.shape != shape:
        raise SeriesError(f"{name} is {values.shape} where {shape} is needed; both must lie on one grid")
    return values


def checked(
    arrays: Mapping[str, NDArray[Any]], tails: Mapping[str, tuple[int, ...]], whole: Sequence[str]
) -> dict[str, NDArray[Any]]:
    """Arrays of one grid by name.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        What a file holds; others than those of `tails` are left alone.
    tails : mapping of str to tuple of int
        Last axes of each, after those of the grid (ny, nx).
    whole : sequence of str
        Names of whole numbers; the others are float64.

    Raises
    ------
    SeriesError
        One is missing, of another shape, or of another kind.
    """
    missing = [name for name in tails if name not in arrays]
    if missing:
        raise SeriesError(f"statistics lack {', '.join(missing)}; the file is damaged or from another version")
    found = {name: np.asarray(arrays[name]) for name in tails}
    first = next(iter(found.values()))
    for name, values in found.items():
        if values.dtype.kind not in ("iu" if name in whole else "f"):
            raise SeriesError(f"{name} holds {values.dtype}; the file is damaged or from another version")
        shaped(name, values, (*first.shape[:2], *tails[name]))
        found[name] = values.astype(np.int64 if name in whole else np.float64)
    return found
