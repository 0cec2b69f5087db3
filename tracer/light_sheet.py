"""The light sheet: particles shine in its plane, which is seldom quite the plane of the target.

The target hangs at z = 0 and a scene fit ties the world to it.  The sheet is set up by another hand; in world
coordinates its middle is

    z = z_mm + tan(tilt_x) x + tan(tilt_y) y.

Behind glass a particle that lies dz before the plane for which a frame was corrected stands dz (dx/dz) beside its
place, with dx/dz the slope of the last straight piece of its ray: 0.1 mm are 0.3 px behind two balls.

Nothing in the tracer knows of a sheet.  A rigid movement takes the sheet to z' = 0 and camera and bodies with it
(`Scene.in_light_sheet`); rays, inversion and derivatives are then those of any scene.  Coordinates on the sheet
are its own: their origin is (0, 0, z_mm), its axes are those of the world turned by the shortest way, so that x'
and y' differ from x and y by half the tilt squared only (15 um at 100 mm and 1 degree), and lengths in the sheet
are true lengths.

What is not known of the plane is a covariance of (z_mm, tan tilt_x, tan tilt_y); see `LightSheet.root`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tracer.camera import Vector3
from tracer.errors import SceneError

UNMEASURED_MM, UNMEASURED_DEG = 0.5, 0.5  # a sheet that was set up by eye
STEEPEST_DEG = 30.0
WIDEST_FAN_DEG = 120.0
FARTHEST = 3.2  # standard deviations of a Gaussian that are traced


@dataclass(frozen=True)
class SheetSource:
    """Source of the light of a sheet; lengths and angles are in the plane of the sheet.

    Parameters
    ----------
    from_deg : float
        Direction from which it comes: 0 from +x (the right), 90 from +y (above), 180 from the left.
    width_mm : float
        Full width of the sheet at the origin, across the light; of a Gaussian profile at e^-2.
    gaussian : bool
        Whether the profile across is a Gaussian; otherwise it is uniform.
    fan_deg : float
        Full opening angle of the fan; 0: parallel light.
    divergence_deg : float
        Full angle at e^-2 across the thickness; 0: parallel light.
    focus_mm : float
        Where the sheet is thinnest: distance behind the origin, along the light.
    power : float
        Brightness in the middle of the sheet without bodies, relative to the other sources.

    Raises
    ------
    SceneError
        There is no such light.
    """

    from_deg: float
    width_mm: float
    gaussian: bool = False
    fan_deg: float = 0.0
    divergence_deg: float = 0.0
    focus_mm: float = 0.0
    power: float = 1.0

    def __post_init__(self) -> None:
        if not (self.width_mm > 0.0 and self.power > 0.0):
            raise SceneError("width_mm and power of a light sheet's source must be positive")
        if not (0.0 <= self.fan_deg <= WIDEST_FAN_DEG and 0.0 <= self.divergence_deg <= WIDEST_FAN_DEG):
            raise SceneError(f"fan_deg and divergence_deg of a light sheet's source are 0 to {WIDEST_FAN_DEG:g}")

    @property
    def bend_per_mm(self) -> float:
        """One over the distance from the apex of the fan to the origin; 0 for parallel light."""
        return 2.0 * float(np.tan(np.deg2rad(0.5 * self.fan_deg))) / self.width_mm

    @property
    def comes_from(self) -> NDArray[np.float64]:
        """Unit vector (3,) towards the source."""
        angle = np.deg2rad(self.from_deg)
        return np.array([np.cos(angle), np.sin(angle), 0.0])

    @property
    def half_mm(self) -> float:
        """Half of the width that is traced, at the origin."""
        return self.width_mm * (0.25 * FARTHEST if self.gaussian else 0.5)

    def meets(self, corners_mm: NDArray[np.float64]) -> bool:
        """Return whether the light would cross a quadrangle of corners (4, 2 or 3) if there were no bodies."""
        x, y = corners_mm[:, 0], corners_mm[:, 1]
        cos, sin, _ = self.comes_from
        across, along = cos * y - sin * x, cos * x + sin * y
        reach = self.half_mm * (1.0 + self.bend_per_mm * float(np.abs(along).max()))
        return bool(across.min() < reach and across.max() > -reach)


@dataclass(frozen=True)
class LightSheet:
    """The plane in which particles are lit.

    Parameters
    ----------
    z_mm : float
        Height of its middle over the origin of the target's plane.
    tilt_x_deg, tilt_y_deg : float
        Tilt; positive ones rise towards the camera with x and with y.
    sigma_mm : float
        Standard deviation of `z_mm`.
    tilt_sigma_deg : float
        Standard deviation of either tilt.
    correlation : (float, float, float)
        Between z and tilt_x, z and tilt_y, tilt_x and tilt_y.
    thickness_mm : float or None
        Full width at e^-2 of the light across it, where it is thinnest; None if unknown.
    sources : tuple of SheetSource
        Where its light comes from, as far as that was said; their light adds up.

    Raises
    ------
    SceneError
        There is no such plane.
    """

    z_mm: float = 0.0
    tilt_x_deg: float = 0.0
    tilt_y_deg: float = 0.0
    sigma_mm: float = UNMEASURED_MM
    tilt_sigma_deg: float = UNMEASURED_DEG
    correlation: Vector3 = (0.0, 0.0, 0.0)
    thickness_mm: float | None = None
    sources: tuple[SheetSource, ...] = ()

    def __post_init__(self) -> None:
        if max(abs(self.tilt_x_deg), abs(self.tilt_y_deg)) > STEEPEST_DEG:
            raise SceneError(
                f"the light sheet is tilted by more than {STEEPEST_DEG:g} degrees; is that its angle?"
            )
        if min(self.sigma_mm, self.tilt_sigma_deg) < 0.0:
            raise SceneError("standard deviations of the light sheet must not be negative")
        if self.thickness_mm is not None and not self.thickness_mm > 0.0:
            raise SceneError("the thickness of the light sheet must be positive")
        if self.sources and self.thickness_mm is None:
            raise SceneError("the light sheet has sources and no thickness_mm; give its full width at e^-2")
        if np.linalg.eigvalsh(self._correlations()).min() < -1e-9:
            raise SceneError("the correlations of the light sheet's numbers contradict each other")

    @property
    def slopes(self) -> tuple[float, float]:
        """Slopes dz/dx and dz/dy."""
        return float(np.tan(np.deg2rad(self.tilt_x_deg))), float(np.tan(np.deg2rad(self.tilt_y_deg)))

    @property
    def is_target_plane(self) -> bool:
        """Return whether it lies in z = 0."""
        return not (self.z_mm or self.tilt_x_deg or self.tilt_y_deg)

    @property
    def summary(self) -> str:
        """Position of the sheet, in words."""
        return (
            f"the light sheet at z = {self.z_mm:+.3f} +- {self.sigma_mm:.3g} mm, tilted by {self.tilt_x_deg:+.3f}"
            f" and {self.tilt_y_deg:+.3f} +- {self.tilt_sigma_deg:.3g} degrees along x and y"
        )

    def height_mm(self, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Height z of its middle at world x, y (any shape)."""
        a, b = self.slopes
        return np.asarray(self.z_mm + a * x_mm + b * y_mm)

    def axes(self) -> NDArray[np.float64]:
        """Axes of the sheet in the world (3, 3): rows x', y', normal: the shortest turn from the world's."""
        return _axes(*self.slopes)

    def place(self, point_mm: Vector3) -> Vector3:
        """Sheet coordinates x', y', z' of a world point."""
        x, y, z = self.axes() @ (np.array(point_mm) - (0.0, 0.0, self.z_mm))
        return float(x), float(y), float(z)

    def root(self) -> NDArray[np.float64]:
        """Root (3, 3) of the covariance of z [mm] and the two slopes: root root^T is the covariance."""
        rad = float(np.deg2rad(self.tilt_sigma_deg))
        a, b = self.slopes
        sigma = np.array([self.sigma_mm, rad * (1.0 + a * a), rad * (1.0 + b * b)])
        values, vectors = np.linalg.eigh(self._correlations())
        return np.asarray(sigma[:, None] * (vectors * np.sqrt(np.maximum(values, 0.0))))

    def pose_root(self) -> NDArray[np.float64]:
        """The same as movements of the plane (6, 3) in its own axes: x, y, z [mm], turns about x, y, z [rad]."""
        step, axes = 1e-6, self.axes()
        out = np.zeros((6, 3))
        out[:3, 0] = axes[:, 2]
        for column, slopes in ((1, (step, 0.0)), (2, (0.0, step))):
            turned = (_axes(*np.add(self.slopes, slopes)) - _axes(*np.subtract(self.slopes, slopes))) @ axes.T
            out[3:, column] = np.array([turned[1, 2], -turned[0, 2], turned[0, 1]]) / (2.0 * step)
        return np.asarray(out @ self.root())

    def _correlations(self) -> NDArray[np.float64]:
        zx, zy, xy = self.correlation
        return np.array([[1.0, zx, zy], [zx, 1.0, xy], [zy, xy, 1.0]])


def _axes(a: float, b: float) -> NDArray[np.float64]:
    """Axes (3, 3) of a plane with slopes a and b."""
    x, y, z = np.array([-a, -b, 1.0]) / np.sqrt(1.0 + a * a + b * b)
    mixed = -x * y / (1.0 + z)
    return np.array([[1.0 - x * x / (1.0 + z), mixed, -x], [mixed, 1.0 - y * y / (1.0 + z), -y], [x, y, z]])
