"""Vectors that are taken out of a field: in masks, where light stands still, and where there are no particles."""

from dataclasses import replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from piv.correlation.common_light import CommonLight
from piv.correlation.settings import SMALLEST_WINDOW_PX
from piv.correlation.vector_field import RESOLUTION_LENGTHS, VectorField, VectorFlag

STANDS = 0.51  # share of what lies around a vector that a mask leaves; half of it on an edge
WITHIN, MEASURED_SHARE = 0.99, 0.3  # of a window that lies in an empty area; of such windows with a vector
UNRELATED_SHARE, UNRELATED_SIGMA_PX = 0.25, 0.15  # fewer vectors, and less certain ones, are there by chance
COMMON_LIGHT_MARGIN = 1.5  # of the shortest vectors: as long ones are not trusted beside shorter ones


def without_still(
    field: VectorField, given: NDArray[np.bool_] | None, still: NDArray[np.bool_], min_valid: float
) -> VectorField:
    """The field without vectors whose middle stands still; what is masked by that alone says so."""
    row, column = (
        np.clip(np.rint(place), 0, side - 1).astype(np.int64)
        for place, side in zip((field.y_px, field.x_px), still.shape, strict=True)
    )
    at = np.ix_(row, column)
    seen = 1.0 if given is None else _share_around(given, field.window_px)[at]
    of_still = (field.flags == VectorFlag.MASKED) & (seen >= min_valid)
    of_still &= _share_around(still, field.window_px)[at] > 0.0
    return without_vectors(field, still[at] | of_still, VectorFlag.STILL)


def without_masked(field: VectorField, given: NDArray[np.bool_]) -> VectorField:
    """The field without vectors within a mask or on its very edge, whose light lies all to one side."""
    row, column = (np.rint(place).astype(np.int64) for place in (field.y_px, field.x_px))
    share = _share_around(given, SMALLEST_WINDOW_PX)
    outside = share[np.ix_(row, column)] < STANDS
    return without_vectors(field, outside, VectorFlag.MASKED)


def is_measured(field: VectorField, empty: NDArray[np.bool_]) -> bool:
    """Return whether vectors stand in an area all the same: particles there are dim, and it is not empty."""
    row, column = (np.clip(np.rint(place), 0, None).astype(np.int64) for place in (field.y_px, field.x_px))
    for side_px in (field.window_px, field.window_px // 2):  # half a window of what is narrower
        within = (_share_around(empty, side_px)[np.ix_(row, column)] >= WITHIN) & field.asked
        if within.any():
            return bool(field.valid[within].mean() > MEASURED_SHARE)
    return True


def without_chance_vectors(field: VectorField) -> VectorField:
    """The field without any vector if the few there are say no more than those of frames that are no pair."""
    if field.valid_share >= UNRELATED_SHARE or not field.valid.any():
        return field
    sigma = field.total_sigma_px[field.valid]
    if np.isfinite(sigma).any() and np.nanmedian(sigma) < UNRELATED_SIGMA_PX:
        return field
    return without_vectors(field, field.asked, VectorFlag.REJECTED)


def without_vectors(field: VectorField, gone: NDArray[np.bool_], flag: VectorFlag) -> VectorField:
    """The field without some of its vectors (ny, nx), which get a flag instead."""
    flags = np.where(gone, np.uint8(flag), field.flags)
    without: dict[str, Any] = {
        name: np.where(gone.reshape(gone.shape + (1,) * (part.ndim - 2)), np.nan, part)
        for name, part in field.lengths.items()
    }
    return replace(field, flags=flags, **without)


def without_seams(field: VectorField, common: CommonLight) -> VectorField:
    """The field of a pair whose common light is off: without short vectors, and what lengthens the others."""
    length_px = np.hypot(field.u_px, field.v_px)
    pushed_px = common.lengthening_px(length_px)
    kept = 1.0 - pushed_px / np.maximum(length_px, common.least_px)
    lengths = field.lengths
    more: dict[str, Any] = {
        name: np.hypot(lengths[name], 0.5 * pushed_px) for name in RESOLUTION_LENGTHS if name in lengths
    }
    if "unfiltered_px" in lengths:
        more["unfiltered_px"] = lengths["unfiltered_px"] * kept[..., None]
    field = replace(
        field,
        u_px=field.u_px * kept,
        v_px=field.v_px * kept,
        common_light_px=common.least_px,
        **more,
    )
    short = field.valid & (length_px < common.least_px)
    # Beside short ones others are pushed beyond that length.
    beside = scipy.ndimage.binary_dilation(short, np.ones((5, 5), bool)) & (
        length_px < COMMON_LIGHT_MARGIN * common.least_px
    )
    return without_vectors(field, field.valid & (short | beside), VectorFlag.REJECTED)


def _share_around(which: NDArray[np.bool_], side_px: int) -> NDArray[np.float32]:
    """Share (H, W) of pixels within windows around each."""
    import cv2

    found: Any = cv2.blur(which.astype(np.float32), (side_px, side_px), borderType=cv2.BORDER_REFLECT)
    return np.asarray(found, np.float32)
