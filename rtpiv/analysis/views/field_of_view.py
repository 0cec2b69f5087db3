"""Field of view through spheres in a row: how much of the investigation plane the glass lets the camera see.

Where every sphere is centred on the line through the pinhole perpendicular to the plane, the whole ray map is
one radial curve r_i -> r_o.  The image radius r_i = L tan(theta) is where the ray would meet the plane without
glass, r_o (signed) is where it does meet it; both from the foot of that line.

From the centre outwards |r_o| grows to r_b, the largest recovered radius, at the FOLD d r_o / d r_i = 0: the
caustic of the refracted bundle.  Beyond it the same radii come back in reverse order, and shrink fast.  With
R the sphere radius and r_red the silhouette in the plane (Martins et al., Opt. Lasers Eng. 2018):

    FOV_in    = (r_b / R)^2                                 of the sphere's own cross-section
    FOV_total = (1 - pi/4) + (pi/4) (r_b / r_red)^2         of the square that frames the silhouette

The curve is traced by the same kernel as the ray map, with a camera of focal length L looking straight down:
its pixel coordinate is then r_i, and the analytic pixel derivative is d r_o / d r_i.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracer.bodies import Sphere
from tracer.camera import Camera, Lens
from tracer.errors import SceneError
from tracer.kernels.rays import trace_pixel_tangents
from tracer.kernels.sphere import CENTRE_X, CENTRE_Y
from tracer.kernels.world import RECOVERED
from tracer.scene.scene import Scene
from tracer.strategies.trace import pack_camera, world_from

COAXIAL_TOL = 1e-9  # off-axis share of a radius that still counts as coaxial: rounding of decimal files
SAMPLES = 512  # of the curve when looking for the fold; spaced as sin, dense at the rim

Sample = tuple[int, float, float, int]  # status, r_o [mm], d r_o / d r_i, branch key


@dataclass(frozen=True)
class FieldOfView:
    """Part of the plane that the camera sees through a coaxial row of spheres.

    Parameters
    ----------
    radius_mm : float
        R, of the largest sphere.
    distance_mm : float
        L, pinhole to plane.
    edge_mm : float
        r_b, largest recovered plane radius.
    fold_mm : float
        Image radius r_i at which it is reached: the fold, or the end of the branch where there is none.
    folds : bool
        True if the recovered region ends in a fold.
    silhouette_mm : float
        r_red, the largest tangent cone of any sphere, referred to the plane.
    centre_magnification : float
        r_i / r_o at the centre; negative where the image is turned by 180 degrees.
    """

    radius_mm: float
    distance_mm: float
    edge_mm: float
    fold_mm: float
    folds: bool
    silhouette_mm: float
    centre_magnification: float

    @property
    def inside(self) -> float:
        """FOV_in = (r_b / R)^2, as a share (1 = the sphere's cross-section)."""
        return (self.edge_mm / self.radius_mm) ** 2

    @property
    def total(self) -> float:
        """FOV_total = (1 - pi/4) + (pi/4) (r_b / r_red)^2, as a share."""
        return (1.0 - math.pi / 4.0) + math.pi / 4.0 * (self.edge_mm / self.silhouette_mm) ** 2


def field_of_view(scene: Scene) -> FieldOfView:
    """Field of view of a scene whose spheres stand in a row on the camera's perpendicular to the plane.

    Parameters
    ----------
    scene : Scene
        Any camera orientation; opaque bodies that are no spheres are disregarded.

    Returns
    -------
    FieldOfView

    Raises
    ------
    SceneError
        The scene has no sphere before the camera, one is off the line, out of round, has a core or reaches through
        the plane, other glass stands in it, or the centre sees no plane point.
    """
    spheres = _row(scene)
    for sphere in spheres:
        if sphere in scene.spheres_in_plane:
            raise SceneError(f"sphere {sphere.name!r} reaches through the plane, whose gaps no radius describes")
        if sphere.cores:
            raise SceneError(f"sphere {sphere.name!r} has a core; a radial field of view is for solid spheres")
    curve = _curve(scene)
    length_mm = scene.camera.position_mm[2]
    silhouette = max(_silhouette_mm(sphere, length_mm) for sphere in spheres)
    status, _, slope, key = curve(0.0)
    if status != RECOVERED:
        raise SceneError("the centre of the view does not reach the plane; the row must be of clear spheres")
    inner, outer = _last_on_branch(curve, silhouette, key)
    rising = math.copysign(1.0, slope)
    fold = outer
    for low, high in pairwise(inner):
        if curve(high)[2] * rising <= 0.0:
            fold = _last(low, high, lambda r: curve(r)[2] * rising > 0.0)
            break
    return FieldOfView(
        radius_mm=max(sphere.radius_mm for sphere in spheres),
        distance_mm=length_mm,
        edge_mm=abs(curve(fold)[1]),
        fold_mm=fold,
        folds=fold < outer,
        silhouette_mm=silhouette,
        centre_magnification=1.0 / slope if slope else math.inf,
    )


def radial_curve(scene: Scene, image_radius_mm: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Plane radius of image radii, with the derivative.

    Parameters
    ----------
    scene : Scene
        A coaxial scene, see `field_of_view`.
    image_radius_mm : array_like
        r_i [mm]; any shape, any sign.

    Returns
    -------
    r_o, slope : arrays of the same shape
        Signed plane radius [mm] and d r_o / d r_i; NaN where no plane point is seen.
    """
    _row(scene)
    curve = _curve(scene)
    radii = np.asarray(image_radius_mm, dtype=np.float64)
    samples = np.array([curve(float(radius))[1:3] for radius in radii.ravel()]).reshape(-1, 2)
    return samples[:, 0].reshape(radii.shape), samples[:, 1].reshape(radii.shape)


def _row(scene: Scene) -> list[Sphere]:
    """Spheres between plane and camera, after checking that they are coaxial."""
    x, y, length_mm = scene.camera.position_mm
    spheres = [sphere for sphere in scene.spheres if sphere.centre_mm[2] < length_mm]
    if not spheres:
        raise SceneError("there is no sphere between the camera and the plane, so there is no view through glass")
    for body in scene.seen:
        if body.media and body not in scene.spheres:
            raise SceneError(f"there is a {body.kind}, {body.name!r}; a radial field of view is for spheres alone")
    for sphere in spheres:
        if sphere.shape_um:
            raise SceneError(f"sphere {sphere.name!r} is out of round; a radial field of view is for round ones")
        off_mm = math.hypot(sphere.centre_mm[0] - x, sphere.centre_mm[1] - y)
        if off_mm > COAXIAL_TOL * sphere.radius_mm:
            raise SceneError(
                f"sphere {sphere.name!r} stands {off_mm:.6g} mm off the perpendicular through the camera; "
                "a radial field of view needs all spheres on it"
            )
    return spheres


def _curve(scene: Scene) -> Callable[[float], Sample]:
    """Return the radial curve as a function of r_i [mm]."""
    x, y, length_mm = scene.camera.position_mm
    down: Camera = replace(
        scene.camera,
        focal_px=length_mm,
        principal_px=(0.0, 0.0),
        rotation=((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)),
        lens=Lens(),
    )
    packed, spheres = pack_camera(down), scene.sphere_table()
    spheres[:, CENTRE_X], spheres[:, CENTRE_Y] = x, y
    world = world_from(spheres)

    def sample(radius_mm: float) -> Sample:
        status, x_mm, _, slope, _, _, _, _, key, _ = trace_pixel_tangents(radius_mm, 0.0, packed, world)
        return int(status), x_mm - x, slope, int(key)

    return sample


def _silhouette_mm(sphere: Sphere, length_mm: float) -> float:
    """L tan of the cone that touches a sphere on the axis."""
    distance, radius = length_mm - sphere.centre_mm[2], sphere.radius_mm
    return length_mm * radius / math.sqrt((distance - radius) * (distance + radius))


def _last_on_branch(curve: Callable[[float], Sample], silhouette: float, key: int) -> tuple[list[float], float]:
    """Samples of r_i on the centre's branch, outwards, and the last of them: its outer end by bisection."""

    def belongs(radius_mm: float) -> bool:
        status, _, _, branch = curve(radius_mm)
        return status == RECOVERED and branch == key

    inside = [0.0]
    for radius in silhouette * np.sin(np.linspace(0.0, math.pi / 2.0, SAMPLES))[1:]:
        low, high = inside[-1], float(radius)
        if belongs(high):
            inside.append(high)
            continue
        inside.append(_last(low, high, belongs))
        break
    return inside, inside[-1]


def _last(low: float, high: float, holds: Callable[[float], bool]) -> float:
    """Last number between `low`, where something holds, and `high`, where it does no more: by halving."""
    while low < (middle := 0.5 * (low + high)) < high:
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low
