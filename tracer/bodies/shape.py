"""The shape of a ball out of round, as a scene file says it.

    shape: {harmonics_um: {C20: -5.6, C22: 3.2}}                              # rms heights, see tracer.harmonics
    shape: {semi_axes_mm: [25.012, 25.0, 24.988], rotation_deg: [0, 0, 30]}   # an ellipsoid, turned by a vector

An ellipsoid is kept as harmonics up to degree 6, which is exact to WORST_MM or refused: semi-axes of 25 mm may
differ by 0.8 mm.
"""

from functools import lru_cache
from typing import Annotated

import numpy as np
import scipy
from pydantic import Field, field_validator, model_validator

from ground.config import Table, Triple
from ground.plain_words import exactly
from tracer.errors import SceneError
from tracer.harmonics import HIGHEST, NAMES, of_ellipsoid, values
from tracer.medium_table import Positive

WORST_MM = 1e-6
SEARCHES = 12
ASIDE = np.stack(np.meshgrid(np.arange(-2.0, 3.0), np.arange(-2.0, 3.0)), axis=-1).reshape(-1, 2)
Shape = tuple[float, ...]  # coefficients [um] in the order of `tracer.harmonics.NAMES`; empty for a sphere


class ShapeTable(Table):
    """Deviation of a ball from a sphere."""

    harmonics_um: dict[str, Annotated[float, Field(ge=-1e4, le=1e4)]] | None = None
    semi_axes_mm: Annotated[list[Positive], Field(min_length=3, max_length=3), exactly(3)] | None = None
    rotation_deg: Triple | None = None

    @field_validator("harmonics_um")
    @classmethod
    def _check_names(cls, value: dict[str, float] | None) -> dict[str, float] | None:
        for name in value or {}:
            if name in ("C00", "C10", "C11", "S11"):
                raise ValueError(
                    f"{name} is no shape: degree 0 is radius_mm, degree 1 moves the ball, which centre_mm does"
                )
            if name not in NAMES:
                raise ValueError(f"there is no {name}; harmonics are C20, C21, S21, C22 ... S{HIGHEST}{HIGHEST}")
        return value

    @model_validator(mode="after")
    def _one(self) -> "ShapeTable":
        if (self.harmonics_um is None) == (self.semi_axes_mm is None):
            raise ValueError("a ball has one shape: give either harmonics_um or semi_axes_mm")
        if self.rotation_deg is not None and self.semi_axes_mm is None:
            raise ValueError("rotation_deg turns semi_axes_mm; harmonics are about the axes of the world")
        return self

    def radius_and_shape(self, name: str, radius_mm: float) -> tuple[float, Shape]:
        """Return mean radius and shape of a ball that is said to have a radius.

        Raises
        ------
        SceneError
            The semi-axes say otherwise, or are too far from a sphere.
        """
        if self.semi_axes_mm is None:
            known = self.harmonics_um or {}
            shape = tuple(known.get(term, 0.0) for term in NAMES)
            return radius_mm, shape if any(shape) else ()
        axes = self.semi_axes_mm
        if not min(axes) <= radius_mm <= max(axes):
            text = f"sphere {name!r}: radius_mm, {radius_mm:g} mm, is none of an ellipsoid of semi_axes_mm {axes}"
            raise SceneError(problems=[("shape", f"{text}; give their mean")])
        turn = np.deg2rad(self.rotation_deg or [0.0, 0.0, 0.0])
        rotation = scipy.spatial.transform.Rotation.from_rotvec(turn).as_matrix()
        mean_mm, shape_mm, error_mm = of_ellipsoid(axes, rotation)
        if error_mm > WORST_MM:
            text = (
                f"sphere {name!r}: harmonics up to degree {HIGHEST} miss an ellipsoid of semi_axes_mm {axes} by"
                f" {1e3 * error_mm:.2g} um; only balls nearly round can be traced"
            )
            raise SceneError(problems=[("shape", text)])
        if max(axes) == min(axes):
            return axes[0], ()
        return mean_mm, tuple((1e3 * shape_mm).tolist())


@lru_cache(maxsize=4096)
def reach_mm(radius_mm: float, shape: Shape, side: float) -> float:
    """Reach of a ball along z from its centre, up (`side` 1) or down (-1).

    The top of u_z r(u) is one hill near the axis: it is sought on ever finer grids about the highest point.
    """
    rest, best, step = np.zeros(2), 0.0, 1.0
    for _ in range(SEARCHES):
        step *= 0.25
        across = rest + step * ASIDE
        directions = np.column_stack((across, side * np.sqrt(1.0 - np.sum(across**2, axis=1))))
        reached = side * directions[:, 2] * (radius_mm + values(directions) @ (1e-3 * np.array(shape)))
        rest, best = across[int(np.argmax(reached))], float(reached.max())
    return best


def shape_section(shape: Shape) -> dict[str, dict[str, float]]:
    """Return a shape as a scene file has it."""
    return {"harmonics_um": {name: value for name, value in zip(NAMES, shape, strict=True) if value != 0.0}}
