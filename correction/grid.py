"""The raster of a corrected image on the investigation plane."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tracer.camera import Camera


@dataclass(frozen=True)
class PlaneGrid:
    """A square raster on z = 0: node (row, column) lies at (x0 + column pitch, y0 - row pitch).

    Parameters
    ----------
    origin_mm : (float, float)
        x0, y0 of node (0, 0), the top-left one.
    pitch_mm : float
        Distance of neighbouring nodes.
    shape : (int, int)
        Rows and columns.
    """

    origin_mm: tuple[float, float]
    pitch_mm: float
    shape: tuple[int, int]

    @property
    def px_per_mm(self) -> float:
        """Scale of the corrected image."""
        return 1.0 / self.pitch_mm

    def nodes_mm(self) -> NDArray[np.float64]:
        """Plane points of all nodes (rows, columns, 2) [mm]."""
        rows, columns = np.indices(self.shape, dtype=np.float64)
        x = self.origin_mm[0] + columns * self.pitch_mm
        y = self.origin_mm[1] - rows * self.pitch_mm
        return np.stack((x, y), axis=-1)

    def to_px(self, plane_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Corrected pixels (..., 2) u, v of plane points (..., 2) [mm]."""
        u = (plane_mm[..., 0] - self.origin_mm[0]) / self.pitch_mm
        v = (self.origin_mm[1] - plane_mm[..., 1]) / self.pitch_mm
        return np.stack((u, v), axis=-1)

    def to_mm(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Plane points (..., 2) [mm] of corrected pixels (..., 2) u, v."""
        x = self.origin_mm[0] + pixels[..., 0] * self.pitch_mm
        y = self.origin_mm[1] - pixels[..., 1] * self.pitch_mm
        return np.stack((x, y), axis=-1)

    def every(self, count: int) -> "PlaneGrid":
        """Grid whose nodes stand for `count` x `count` of this one, in their middles."""
        middle = 0.5 * (count - 1) * self.pitch_mm
        origin = self.origin_mm[0] + middle, self.origin_mm[1] - middle
        shape = -(-self.shape[0] // count), -(-self.shape[1] // count)
        return PlaneGrid(origin, count * self.pitch_mm, shape)


def grid_of(camera: Camera) -> PlaneGrid:
    """Grid that shows the plane as an ideal camera straight above it would.

    One corrected pixel is one sensor pixel at the distance of the plane, the sensor's size is kept, and the
    principal point keeps its place: for a camera that looks straight down, node (row, column) is exactly
    what the ideal pixel (row, column) sees without glass.
    """
    pitch = camera.position_mm[2] / camera.focal_px
    axis = camera.rotation_matrix[2]
    reach = -camera.position_mm[2] / axis[2]
    u, v = camera.principal_px
    x = camera.position_mm[0] + reach * axis[0] - u * pitch
    y = camera.position_mm[1] + reach * axis[1] + v * pitch
    return PlaneGrid((float(x), float(y)), float(pitch), camera.shape)
