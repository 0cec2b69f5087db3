"""What a fit holds without saying how well it is known, as numbers that are doubted.

A 0 in the fit section holds a number of the glass, be it a ball's or a wall's; nobody said how well it is known.
The fit does not move it, but the map is not better for that: with J the derivatives of the residuals r by the free
numbers x, K those by the held ones a in units of what labs ordinarily do not know, and G = (J, K),

    C = (G^T G + 1)^-1,        (x, a) off by -C (G^T r + (x, 0)),

C is the covariance of both, so that the frames tell what they can of a.  Where residuals pull at a, the
Newton step says how far the map is likely off: one more column of the root of the covariance.  A sigma in the fit
section, however small, is believed.  A ball that shows no corner and is held is thus as unsure as one that is
free, for its map rests on what was said of it and on nothing else.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from correction.fit.solve.unknowns import Unknowns, glasses
from tracer.media import THINNEST_LIQUID
from tracer.scene.fit_section import FitTable

BELIEVED = FitTable()  # what is believed of a scene that says nothing
PLACE_MM = BELIEVED.spheres.centre_mm
ORDINARY = {"x": PLACE_MM, "y": PLACE_MM, "z": PLACE_MM, "radius": BELIEVED.spheres.radius_mm}
WALL = {"place_mm": 0.2, "tilt_deg": np.deg2rad(0.3), "thickness_mm": 0.1, "radius_mm": 0.1}  # mm, rad
ORDINARY_N = BELIEVED.n


def doubted(unknowns: Unknowns) -> Unknowns:
    """Return the same unknowns with the held numbers of the glass behind the free ones, in their ordinary size."""
    held = list(_held(unknowns))
    names = (*unknowns.names, *(name for name, _ in held))
    return replace(unknowns, names=names, columns=np.column_stack([unknowns.columns, *(one for _, one in held)]))


def _held(unknowns: Unknowns) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """Numbers of the glass that no free one moves, with their columns (F,); one n for all balls of a glass."""
    scene, free = unknowns.scene, np.any(unknowns.columns != 0.0, axis=1)

    def column(sizes: dict[str, float]) -> NDArray[np.float64]:
        return np.array([sizes.get(name, 0.0) for name in unknowns.full_names])

    for sphere in scene.spheres:
        for part, size in ORDINARY.items():
            name = f"{sphere.name}.{part}"
            if sphere.medium is not None and not free[unknowns.full_names.index(name)]:
                yield name, column({name: size})
    for body, numbers in unknowns.other_bodies.bodies:
        for number in numbers:
            name = f"{body.name}.{number.name}"
            if not free[unknowns.full_names.index(name)]:
                yield name, column({name: WALL.get(number.known, ORDINARY_N)})
    for label, medium in glasses(scene).items():
        sizes = {f"{sphere.name}.n": ORDINARY_N for sphere in scene.spheres if sphere.medium == medium}
        is_free = any(free[unknowns.full_names.index(name)] for name in sizes)
        if not is_free and medium.n(scene.wavelength_nm) > THINNEST_LIQUID:
            yield label, column(sizes)
