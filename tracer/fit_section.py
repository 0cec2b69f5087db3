"""The ``fit:`` section of a scene file: what a scene fit may change, and how far each number is trusted.

Every figure is the standard deviation of the number in the scene file, as known before any frame is seen:
stage accuracy, catalogue tolerance.  0 holds a number fixed; what is not given has the default below.

    fit:
      camera: {position_mm: 2.0, rotation_deg: 2.0, focal_px: 0.0, principal_px: 0.0, k1: 1.0}
      spheres: {centre_mm: 1.0, radius_mm: 0.02}      # of every sphere ...
      walls: {place_mm: 1.0, tilt_deg: 1.0, thickness_mm: 0.1, radius_mm: 0.3}     # of every window and tube
      named: {front: {radius_mm: 0.0}, window: {tilt_deg: 0.0}}                    # ... but these
      n: 0.005                                        # of every glass ...
      glasses: {crown: 0.001}                         # ... but this one
      target: {sideways_mm: 0.02, z_mm: 0.01, rotation_deg: 0.0}    # planes other than z = 0
      light: {colour_temperature_k: 4000.0}         # of the target frames, see tracer.light_table

``focal_px`` left out means: free (0.3 %) if the bare target was seen at three or more heights, else fixed,
because one plane cannot tell the focal length from the distance.
"""

from typing import Annotated

from pydantic import Field

from ground.config import Table
from tracer.light_table import LightTable

Sigma = Annotated[float, Field(ge=0.0, le=1e6)]
FOCAL_SHARE = 0.003  # of the focal length, when a z-stack can tell it from the distance


class FitCameraTable(Table):
    """Standard deviations of the camera's numbers."""

    position_mm: Sigma = 2.0
    rotation_deg: Sigma = 2.0
    focal_px: Sigma | None = None
    principal_px: Sigma = 0.0
    k1: Sigma = 1.0
    k2: Sigma = 0.0
    k3: Sigma = 0.0
    p1: Sigma = 0.0
    p2: Sigma = 0.0


class FitSphereTable(Table):
    """Standard deviations of a sphere's numbers."""

    centre_mm: Sigma = 1.0
    radius_mm: Sigma = 0.02


class FitWallTable(Table):
    """Standard deviations of the numbers of a window or tube."""

    place_mm: Sigma = 1.0
    tilt_deg: Sigma = 1.0
    thickness_mm: Sigma = 0.1
    radius_mm: Sigma = 0.3


class FitNamedTable(Table):
    """The same for one body; what is not given is as for all of its kind."""

    centre_mm: Sigma | None = None
    radius_mm: Sigma | None = None
    place_mm: Sigma | None = None
    tilt_deg: Sigma | None = None
    thickness_mm: Sigma | None = None


class FitTargetTable(Table):
    """Standard deviations of the target's pose at heights other than 0 (there it defines the world)."""

    sideways_mm: Sigma = 0.02
    z_mm: Sigma = 0.01
    rotation_deg: Sigma = 0.0


class FitTable(Table):
    """What is known before the fit."""

    camera: FitCameraTable = FitCameraTable()
    spheres: FitSphereTable = FitSphereTable()
    walls: FitWallTable = FitWallTable()
    named: dict[str, FitNamedTable] = Field(default_factory=dict)
    n: Sigma = 0.005
    glasses: dict[str, Sigma] = Field(default_factory=dict)
    target: FitTargetTable = FitTargetTable()
    light: LightTable | None = None

    def sphere(self, name: str) -> FitSphereTable:
        """Return what is known of the sphere called `name`."""
        own = self.named.get(name, FitNamedTable())
        centre = self.spheres.centre_mm if own.centre_mm is None else own.centre_mm
        radius = self.spheres.radius_mm if own.radius_mm is None else own.radius_mm
        return FitSphereTable(centre_mm=centre, radius_mm=radius)

    def wall(self, name: str) -> FitWallTable:
        """Return what is known of the window or tube called `name`."""
        own = self.named.get(name, FitNamedTable()).model_dump(exclude_none=True, exclude={"centre_mm"})
        return self.walls.model_copy(update=own)

    def index(self, glass: str) -> float:
        """Return the sigma of n of the glass called `glass`."""
        return self.glasses.get(glass, self.n)
