"""The ``fit:`` section of a scene file: what a scene fit may change, and how far each number is trusted.

Every figure is the standard deviation of the number in the scene file, as known before any frame is seen:
stage accuracy, catalogue tolerance.  0 holds a number fixed; what is not given has the default below.

    fit:
      camera: {position_mm: 2.0, rotation_deg: 2.0, focal_px: 0.0, principal_px: 0.0, k1: 1.0}
      spheres: {centre_mm: 1.0, radius_mm: 0.02}      # of every sphere ...; out_of_round_um: 10.0 frees its shape
      walls: {place_mm: 1.0, tilt_deg: 1.0, thickness_mm: 0.1, radius_mm: 0.3}     # of every window and tube
      named: {front: {radius_mm: 0.0}, window: {tilt_deg: 0.0}}                    # ... but these
      contact_mm: 0.02                                # balls that touch in the file do so on the bench, this well
      n: 0.005                                        # of every glass ...
      glasses: {crown: 0.001}                         # ... but this one
      target: {sideways_mm: 0.02, z_mm: 0.01, rotation_deg: 0.0}    # planes other than z = 0
      light: {colour_temperature_k: 4000.0}         # of the target frames, see tracer.light_table
      wavelength_nm: 0.0                              # 5 where a lamp lights the particles, and no laser

``focal_px`` left out means: free (0.3 %) if the bare target was seen at three or more heights, else fixed,
because one plane cannot tell the focal length from the distance.
"""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ground.config import Table
from ground.usual import Usual
from tracer.harmonics import DEGREES, HIGHEST, LOWEST, up_to
from tracer.light_table import LightTable

Sigma = Annotated[float, Field(ge=0.0, le=1e6)]
Degree = Annotated[int, Field(ge=LOWEST, le=HIGHEST)]
SHAPE_KEYS = ("out_of_round_um", "out_of_round_degree")
FOCAL_SHARE = 0.003  # of the focal length, when a z-stack can tell it from the distance


class FitCameraTable(Table):
    """Standard deviations of the camera's numbers."""

    position_mm: Annotated[Sigma, Usual(0.0, 20.0)] = 2.0
    rotation_deg: Annotated[Sigma, Usual(0.0, 10.0)] = 2.0
    focal_px: Sigma | None = None
    principal_px: Sigma = 0.0
    k1: Annotated[Sigma, Usual(0.0, 5.0)] = 1.0
    k2: Sigma = 0.0
    k3: Sigma = 0.0
    p1: Sigma = 0.0
    p2: Sigma = 0.0
    pixel_aspect: Sigma = 1e-4  # of boards held by hand alone: cameras of scenes have square pixels


class FitSphereTable(Table):
    """Standard deviations of a sphere's numbers."""

    centre_mm: Annotated[Sigma, Usual(0.0, 5.0)] = 1.0
    radius_mm: Annotated[Sigma, Usual(0.0, 0.5)] = 0.02
    out_of_round_um: Sigma = 0.0
    out_of_round_degree: Degree = 2

    def shape_mm(self) -> NDArray[np.float64]:
        """Standard deviations (45,) of the harmonics [mm]; 0 for those that are held.

        An ellipsoid takes `out_of_round_um` in all, rms over the ball; a number of degree l has (2 / l)^2 of one
        of its five: what is ground or drawn is smooth.
        """
        free = self.out_of_round_degree >= DEGREES
        return np.where(free, 1e-3 * self.out_of_round_um / np.sqrt(up_to(LOWEST)) * (LOWEST / DEGREES) ** 2, 0.0)


class FitWallTable(Table):
    """Standard deviations of the numbers of a window or tube."""

    place_mm: Annotated[Sigma, Usual(0.0, 5.0)] = 1.0
    tilt_deg: Annotated[Sigma, Usual(0.0, 5.0)] = 1.0
    thickness_mm: Sigma = 0.1
    radius_mm: Sigma = 0.3


class FitNamedTable(Table):
    """The same for one body; what is not given is as for all of its kind."""

    centre_mm: Sigma | None = None
    radius_mm: Sigma | None = None
    out_of_round_um: Sigma | None = None
    out_of_round_degree: Degree | None = None
    place_mm: Sigma | None = None
    tilt_deg: Sigma | None = None
    thickness_mm: Sigma | None = None


class FitTargetTable(Table):
    """Standard deviations of the target's pose at heights other than 0 (there it defines the world)."""

    sideways_mm: Annotated[Sigma, Usual(0.0, 1.0)] = 0.02
    z_mm: Annotated[Sigma, Usual(0.0, 1.0)] = 0.01
    rotation_deg: Sigma = 0.0


class FitTable(Table):
    """Prior knowledge for the fit."""

    camera: FitCameraTable = FitCameraTable()
    spheres: FitSphereTable = FitSphereTable()
    walls: FitWallTable = FitWallTable()
    named: dict[str, FitNamedTable] = Field(default_factory=dict)
    contact_mm: Annotated[float, Field(gt=0.0, le=10.0)] | None = None
    n: Annotated[Sigma, Usual(0.0, 0.02)] = 0.005
    glasses: Annotated[dict[str, Sigma], Usual(0.0, 0.02)] = Field(default_factory=dict)
    target: FitTargetTable = FitTargetTable()
    light: LightTable | None = None
    wavelength_nm: Annotated[Sigma, Usual(0.0, 50.0)] = 0.0

    def sphere(self, name: str) -> FitSphereTable:
        """Return what is known of the sphere called `name`."""
        own = self.named.get(name, FitNamedTable()).model_dump(
            exclude_none=True, include=set(FitSphereTable.model_fields)
        )
        return self.spheres.model_copy(update=own)

    def wall(self, name: str) -> FitWallTable:
        """Return what is known of the window or tube called `name`."""
        own = self.named.get(name, FitNamedTable()).model_dump(
            exclude_none=True, include=set(FitWallTable.model_fields)
        )
        return self.walls.model_copy(update=own)

    def index(self, glass: str) -> float:
        """Return the sigma of n of the glass called `glass`."""
        return self.glasses.get(glass, self.n)
