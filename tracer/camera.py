"""The camera: where a pixel looks.

A pinhole at ``position_mm`` with the sensor ``focal_px`` behind it, turned by ``rotation`` (rows are the
camera's x, y, z axes in world coordinates, so  d_cam = rotation @ d_world;  camera frame as in OpenCV:
x right, y down, z forward).  Pixel (0, 0) is the centre of the top-left pixel.

Lens terms map the ACQUIRED pixel to the IDEAL pinhole pixel, because that is the direction in which rays
are traced; no iteration stands between a pixel and its ray.  With x = (u - c_u)/focal_px, y likewise,
r^2 = x^2 + y^2:

    x_ideal = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)
    y_ideal = y (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y

(Brown, Photogramm. Eng. 32, 444 (1966), used from distorted to ideal.)  Positive k1 undoes barrel distortion.

Thin lens: a lens of focal length f focused on a plane at distance L has its image at
d_i = 1/(1/f - 1/L), hence focal_px = d_i / pixel pitch, and the scale on the plane is f/(L - f) / pitch.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracer.errors import SceneError
from tracer.pupil import Pupil

Vector3 = tuple[float, float, float]

SMALLEST_MM = 1e-9  # a picometre: the smallest radius
# A million kilometres; far below where squares of lengths leave float64
LONGEST_MM = 1e12
STEEPEST_SENSOR = float(np.cos(np.deg2rad(80.0)))  # cosine of the largest tilt
SETTLED_PX = 1e-12  # a round that no longer matters


@dataclass(frozen=True)
class Lens:
    """Distortion terms, acquired -> ideal, in units of the focal length (see module docstring)."""

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

    @property
    def is_ideal(self) -> bool:
        """True if every term is zero."""
        return not (self.k1 or self.k2 or self.k3 or self.p1 or self.p2)

    def apply(self, acquired: NDArray[np.float64]) -> NDArray[np.float64]:
        """Ideal image points (..., 2) of acquired ones, both over the focal length (see module docstring)."""
        x, y = acquired[..., 0], acquired[..., 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        return np.stack(
            (
                x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
                y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
            ),
            axis=-1,
        )

    def terms(self) -> NDArray[np.float64]:
        """Terms as an array (5,): k1, k2, k3, p1, p2."""
        return np.array([self.k1, self.k2, self.k3, self.p1, self.p2])


@dataclass(frozen=True)
class Camera:
    """A pinhole camera with lens terms.

    Parameters
    ----------
    focal_px : float
        Distance pinhole to sensor in pixels.
    principal_px : (float, float)
        Pixel (u, v) on the optical axis.
    sensor_px : (int, int)
        Width and height.
    position_mm : (float, float, float)
        Pinhole in world coordinates.
    rotation : 3 x 3 nested tuple
        World direction -> camera direction, orthonormal; determinant +1, and -1 of a camera that looks by a mirror
        or reverses its columns: its x runs to the left (`mirrored`).
    lens : Lens
        Distortion terms.
    pupil : Pupil, optional
        Aperture and focus; None is a pinhole, sharp everywhere.
    """

    focal_px: float
    principal_px: tuple[float, float]
    sensor_px: tuple[int, int]
    position_mm: Vector3
    rotation: tuple[Vector3, Vector3, Vector3]
    lens: Lens = field(default_factory=Lens)
    pupil: Pupil | None = None

    def __post_init__(self) -> None:
        matrix = np.array(self.rotation)
        if not 1e-6 <= self.focal_px <= 1e12:
            raise SceneError("the camera's focal length must be positive, 1e-6 to 1e12 px")
        if min(self.sensor_px) < 1:
            raise SceneError("the camera's sensor must have at least one pixel each way")
        if not all(abs(value) <= 1e9 for value in self.principal_px):
            raise SceneError("the camera's principal point must lie within 1e9 px")
        if not all(abs(term) <= 1e6 for term in self.lens.terms()):
            raise SceneError("the camera's lens terms must lie within 1e6")
        if not within_reach(self.position_mm):
            raise SceneError(f"the camera must stand within {LONGEST_MM:g} mm of the origin")
        if not self.position_mm[2] > 0.0:
            raise SceneError("the camera must stand in front of the investigation plane, at z > 0")
        entries = np.all(np.abs(matrix) < 2.0)  # before they are squared
        if not entries or not np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-9):
            raise SceneError("the camera's rotation must be orthonormal")

    def with_width(self, width_px: int) -> "Camera":
        """Return the same view on a sensor of so many pixels across: larger or smaller pixels, the same field."""
        ratio = width_px / self.sensor_px[0]
        u, v = ((c + 0.5) * ratio - 0.5 for c in self.principal_px)
        size_px = (width_px, max(1, round(self.sensor_px[1] * ratio)))
        return replace(self, focal_px=self.focal_px * ratio, principal_px=(u, v), sensor_px=size_px)

    @property
    def shape(self) -> tuple[int, int]:
        """Image shape (rows, columns)."""
        return self.sensor_px[1], self.sensor_px[0]

    @property
    def is_mirrored(self) -> bool:
        """Return whether frames are mirror images: seen by a mirror, or with columns reversed."""
        return bool(np.linalg.det(np.array(self.rotation)) < 0.0)

    def mirrored(self) -> "Camera":
        """Return the camera whose frames are mirror images of this one's, about its principal point."""
        (x, y, z), below, ahead = self.rotation
        return replace(self, rotation=((-x, -y, -z), below, ahead))

    def with_tilted_sensor(self, tilt_x_rad: float, tilt_y_rad: float) -> "Camera":
        """Return the camera with its sensor turned about its u axis, then about its own v axis.

        The sensor of a pinhole camera may have any direction (Scheimpflug): with its axes e_1, e_2 and normal n in
        the frame of the lens it is the camera that looks along n, with the focal length f n_z and the principal
        point c - f (e_1z, e_2z).

        Raises
        ------
        SceneError
            The lens has distortion or an aperture, which are about its own axis; or the tilt is too large.
        """
        if not (tilt_x_rad or tilt_y_rad):
            return self
        if not self.lens.is_ideal or self.pupil is not None:
            raise SceneError(
                "a tilted sensor goes with a pinhole without lens terms: these are about the lens axis"
            )
        (cx, sx), (cy, sy) = ((np.cos(a), np.sin(a)) for a in (tilt_x_rad, tilt_y_rad))
        turn = np.array([[cy, sx * sy, -cx * sy], [0.0, cx, sx], [sy, -sx * cy, cx * cy]])  # rows e_1, e_2, n
        if turn[2, 2] < STEEPEST_SENSOR:
            raise SceneError("the sensor must be tilted by less than 80 degrees")
        (first, second, third), f = (turn @ self.rotation_matrix).tolist(), self.focal_px
        u, v = (c - f * float(axis[2]) for c, axis in zip(self.principal_px, turn, strict=False))
        rotation = tuple(first), tuple(second), tuple(third)
        return replace(self, focal_px=f * float(turn[2, 2]), principal_px=(u, v), rotation=rotation)

    @property
    def rotation_matrix(self) -> NDArray[np.float64]:
        """World -> camera rotation (3, 3)."""
        return np.array(self.rotation)

    def ideal(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Ideal pinhole pixels (..., 2) of acquired pixels (..., 2): the lens terms applied."""
        acquired = np.asarray(pixels, dtype=np.float64)
        if self.lens.is_ideal:
            return acquired.copy()
        centre = np.array(self.principal_px)
        return np.asarray(centre + self.focal_px * self.lens.apply((acquired - centre) / self.focal_px))

    def coarser(self, times: int) -> "Camera":
        """Return the camera with pixels `times` times wider, same view except a rest at the far edges."""
        if times == 1:
            return self
        (cu, cv), (width, height) = self.principal_px, self.sensor_px
        return replace(
            self,
            focal_px=self.focal_px / times,
            principal_px=((cu + 0.5) / times - 0.5, (cv + 0.5) / times - 0.5),
            sensor_px=(max(1, width // times), max(1, height // times)),
        )

    def directions(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Unit world directions (..., 3) of the rays through acquired pixels (..., 2)."""
        ideal = self.ideal(pixels)
        xy = (ideal - np.array(self.principal_px)) / self.focal_px
        local = np.concatenate((xy, np.ones((*xy.shape[:-1], 1))), axis=-1)
        world = local @ self.rotation_matrix
        return np.asarray(world / np.linalg.norm(world, axis=-1, keepdims=True))

    def project_ideal(self, points_mm: ArrayLike) -> NDArray[np.float64]:
        """Ideal pinhole pixels (..., 2) of world points (..., 3) [mm]; NaN behind the camera."""
        local = (np.asarray(points_mm, dtype=np.float64) - np.array(self.position_mm)) @ self.rotation_matrix.T
        depth = np.where(local[..., 2:] > 0.0, local[..., 2:], np.nan)
        return np.asarray(np.array(self.principal_px) + self.focal_px * local[..., :2] / depth)

    def acquired(self, ideal_px: ArrayLike) -> NDArray[np.float64]:
        """Acquired pixels (..., 2) of ideal pinhole pixels (..., 2): the inverse of `ideal`.

        Notes
        -----
        Fixed point x <- x_ideal - (ideal(x) - x); the terms are small, each round gains at least a digit.
        Pixels where it does not settle within 60 rounds (far outside any sensor) are NaN.
        """
        wanted = np.asarray(ideal_px, dtype=np.float64)
        if self.lens.is_ideal:
            return wanted.copy()
        acquired = wanted.copy()
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(60):
                step = wanted - self.ideal(acquired)
                acquired = acquired + step
                if not (np.abs(step) > SETTLED_PX).any():
                    break
            acquired[~(np.abs(wanted - self.ideal(acquired)).max(axis=-1) < 1e-9)] = np.nan
        return acquired

    def project(self, points_mm: ArrayLike) -> NDArray[np.float64]:
        """Acquired pixels (..., 2) of world points (..., 3) [mm] seen directly, without glass."""
        return self.acquired(self.project_ideal(points_mm))


def within_reach(point_mm: Vector3) -> bool:
    """Return whether a point is finite and no farther than LONGEST_MM along any axis."""
    return all(abs(coordinate) <= LONGEST_MM for coordinate in point_mm)


def thin_lens_distance_mm(f_mm: float, focus_mm: float) -> float:
    """Image distance d_i = 1/(1/f - 1/L) = f L/(L - f) of a lens focused on a plane at distance L [mm].

    Raises
    ------
    SceneError
        The plane is not beyond the focal length, so no real image exists.
    """
    if not focus_mm > f_mm > 0.0:
        raise SceneError(f"a lens of f = {f_mm:g} mm cannot focus at L = {focus_mm:g} mm; L must exceed f")
    return f_mm * focus_mm / (focus_mm - f_mm)


def look_at(position_mm: Vector3, target_mm: Vector3, roll_rad: float = 0.0) -> tuple[Vector3, Vector3, Vector3]:
    """Rotation of a camera at `position_mm` whose axis meets `target_mm`.

    The camera's up direction is (sin roll, cos roll, 0) made orthogonal to the axis: positive roll leans
    the camera's top towards +x.

    Raises
    ------
    SceneError
        Position and target coincide or are out of reach, or the camera looks along its up direction.
    """
    if not (within_reach(position_mm) and within_reach(target_mm)):
        raise SceneError(f"position_mm and look_at_mm must lie within {LONGEST_MM:g} mm of the origin")
    forward = np.array(target_mm, dtype=np.float64) - np.array(position_mm, dtype=np.float64)
    distance = float(np.linalg.norm(forward))
    if distance == 0.0:
        raise SceneError("the camera cannot look at its own position; move position_mm or look_at_mm")
    forward /= distance
    up = np.array([np.sin(roll_rad), np.cos(roll_rad), 0.0])
    up -= (up @ forward) * forward
    length = float(np.linalg.norm(up))
    if length < 1e-9:
        raise SceneError("the camera looks straight along its up direction; give another pose")
    up /= length
    right = np.cross(forward, up)
    rows = (right, -up, forward)
    return tuple((float(row[0]), float(row[1]), float(row[2])) for row in rows)  # type: ignore[return-value]
