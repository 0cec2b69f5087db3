"""An independent renderer: the eye of the simulated camera, against which every correction is judged.

It shares the scene's nouns with the tracer and none of its arithmetic (see `sim.renderer.kernels.rays`).

Each pixel is the mean of n x n rays.  Where glass compresses the view, so that a pixel sees more than
`CROWDED` times the width it would see without glass, or where only part of its rays arrive (rims,
silhouettes), it is traced again with 2n x 2n.
"""

import time
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ground.memory import require_memory
from ground.rows import run_rows
from sim.renderer.bodies import WALLS, as_rows, ball_around, ball_rows, wall_rows
from sim.renderer.kernels.rays import average_weighted, trace_pixels
from sim.renderer.kernels.surfaces import World
from sim.renderer.kernels.walls import NUMBERS
from sim.renderer.patterns import Pattern, Plate, Pose
from sim.renderer.sensor import Sensor
from tracer.bodies import CONTACT_TOL_MM, Body, Rod, Sphere
from tracer.camera import Camera
from tracer.errors import SceneError
from tracer.scene.scene import Scene

BLOCK_ROWS = 4
BYTES_PER_PX = 30.0  # light, counts and noise of a frame
CROWDED = 2.5
PROBED_PX = 1500  # whose drawing is timed, 15 to 200 ms


@dataclass(frozen=True)
class Aperture:
    """A thin lens in place of the pinhole: its pupil has the diameter f / f_number.

    With a tilted sensor the plane in focus is oblique: it meets the planes of lens and sensor in one line
    (Scheimpflug).  The tilt changes what is sharp and the axis of lens terms, not where the pupil's middle looks.

    Parameters
    ----------
    f_mm : float
        Focal length.
    f_number : float
        Aperture.
    focus_mm : float
        Distance pinhole to the plane in focus, along the optical axis.
    sensor_tilt_rad : (float, float)
        By which the sensor is turned against the lens, about its u axis, then about its own v axis.
    """

    f_mm: float
    f_number: float
    focus_mm: float
    sensor_tilt_rad: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if min(self.f_mm, self.f_number, self.focus_mm) <= 0.0:
            raise SceneError("f_mm, f_number and focus_mm of an aperture must be positive")

    @property
    def pupil_radius_mm(self) -> float:
        """Radius of the pupil."""
        return 0.5 * self.f_mm / self.f_number


@dataclass(frozen=True)
class SceneTables:
    """A scene as the compiled loops want it."""

    world: World
    px_mm: float  # width a pixel sees on the sheet without glass


def render(
    scene: Scene,
    pattern: Pattern,
    sensor: Sensor,
    *,
    samples: int = 4,
    seed: int = 0,
    illumination: float = 1.0,
    aperture: Aperture | None = None,
) -> NDArray[np.uint16]:
    """Take one frame.

    Parameters
    ----------
    scene : Scene
        Camera and bodies.
    pattern : Pattern
        What hangs at its pose.
    sensor : Sensor
        Blur, gain, noise and depth.
    samples : int
        A pixel is integrated by samples x samples rays, twice as many each way where the view is compressed.
    seed : int
        Of the pixels' sample patterns and of the noise; two frames of one scene need two seeds.
    illumination : float
        Factor on the light.
    aperture : Aperture, optional
        A finite pupil; give `samples` 8 or more with it.

    Returns
    -------
    ndarray
        Counts, uint16 (H, W).

    Raises
    ------
    SceneError
        A body crosses the pattern's plane.
    MemoryShort
        A frame does not fit into memory.
    """
    height, width = scene.camera.shape
    require_memory(BYTES_PER_PX * height * width, f"a rendered frame of {width} x {height} px")
    light = render_irradiance(scene, pattern, samples=samples, seed=seed, aperture=aperture)
    return sensor.expose(light, seed=seed, illumination=illumination)


def render_irradiance(
    scene: Scene,
    pattern: Pattern,
    *,
    samples: int = 4,
    seed: int = 0,
    aperture: Aperture | None = None,
    sheet_mm: tuple[float, float] | None = None,
) -> NDArray[np.float32]:
    """Return the light on each pixel, float32 (H, W): 1 = white sheet without glass; see `render` and `tables_of`.

    Raises
    ------
    SceneError
        `samples` is below 1, a body crosses the pattern's sheet, or is neither sphere nor rod.
    """
    if samples < 1:
        raise SceneError("samples must be at least 1")
    tables = tables_of(scene, pattern.pose, aperture, sheet_mm)
    height, width = scene.camera.shape
    out = np.empty((height, width), np.float32)

    def block(first: int, last: int) -> None:
        rows, columns = np.mgrid[first:last, 0:width]
        pixels = np.column_stack((rows.ravel(), columns.ravel()))
        out[first:last] = _light_on(tables, pattern, pixels, samples, seed).reshape(last - first, width)

    run_rows(block, height, BLOCK_ROWS)
    return out


def drawing_s(
    scene: Scene, pattern: Pattern, samples: int, aperture: Aperture | None, sheet_mm: tuple[float, float] | None
) -> float:
    """Return the seconds of a core that a pixel of `render_irradiance` takes here, measured on some of them."""
    tables = tables_of(scene, pattern.pose, aperture, sheet_mm)
    pixels = np.random.default_rng(0).integers(scene.camera.shape, size=(PROBED_PX, 2))
    _light_on(tables, pattern, pixels[:1], samples, 0)  # code that has to be loaded first is no part of it
    begun_s = time.thread_time()
    _light_on(tables, pattern, pixels, samples, 0)
    return (time.thread_time() - begun_s) / PROBED_PX


def _light_on(
    tables: SceneTables, pattern: Pattern, pixels: NDArray[np.int64], samples: int, seed: int
) -> NDArray[np.float32]:
    """Light (N,) on pixels (N, 2), with more rays where they need it."""
    light, spread = _sample(tables, pattern, pixels, samples, seed)
    again = np.flatnonzero(spread > CROWDED * tables.px_mm)
    for part in np.array_split(again, 1 + len(again) // 4096):
        light[part] = _sample(tables, pattern, pixels[part], 2 * samples, seed)[0]
    return light


def _sample(
    tables: SceneTables, pattern: Pattern, pixels: NDArray[np.int64], n: int, seed: int
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Light (N,) and spread of the seen points (N,) [mm] of pixels (N, 2), by n x n rays each."""
    count = len(pixels)
    points = np.empty((count, n * n, 2))
    transmittance = np.empty((count, n * n), np.float32)
    spread, light = np.empty(count), np.empty(count, np.float32)
    world, order = tables.world, _pupil_order(n)
    trace_pixels(pixels, n, seed, world, order, points, transmittance, spread)
    if isinstance(pattern, Plate):  # the same rays to either level
        levels = []
        for above_mm in (pattern.face_mm, pattern.ground_mm):
            plane, on_level = world.plane.copy(), np.empty_like(points)
            plane[0] += above_mm * plane[3]
            trace_pixels(pixels, n, seed, world._replace(plane=plane), order, on_level, transmittance, spread)
            levels.append(on_level.reshape(-1, 2))
        values = pattern.shade(*levels).reshape(count, n * n)
    else:
        values = pattern.reflectance(points.reshape(-1, 2)).reshape(count, n * n)
    average_weighted(values, transmittance, light)
    return light, spread


@cache
def _pupil_order(n: int) -> NDArray[np.int64]:
    """Fixed shuffle that pairs the n*n places in a pixel with the n*n places in the pupil."""
    return np.random.default_rng(n).permutation(n * n)


def tables_of(
    scene: Scene,
    pose: Pose,
    aperture: Aperture | None,
    sheet_mm: tuple[float, float] | None = None,
    *,
    is_light: bool = False,
) -> SceneTables:
    """Translate scene, place of the sheet and aperture into arrays.

    Parameters
    ----------
    scene : Scene
        Camera and bodies.
    pose : Pose
        Place of the sheet.
    aperture : Aperture or None
        A finite pupil.
    sheet_mm : (float, float), optional
        Width and height of the sheet about its origin: beside it bodies may cross its plane, such as glass that
        was driven out, or a support.  Without it the sheet has no end.
    is_light : bool
        Whether it is a sheet of light, which may run through balls, and no board.

    Raises
    ------
    SceneError
        A body crosses the sheet, or is of a kind that has no optics here.
    """
    camera, plane = scene.camera, pose.axes()
    bodies = [body for body in scene.bodies if _in_front(body, plane, sheet_mm, is_light)]
    spheres, rods = Sphere.among(bodies), Rod.among(bodies)
    walls = [body for body in bodies if type(body) in WALLS]
    if unknown := [body for body in bodies if body not in (*spheres, *rods, *walls)]:
        raise SceneError(f"the simulator cannot render {unknown[0].name!r}, a {unknown[0].kind}")
    world = World(
        camera=_camera_numbers(scene.camera, aperture),
        spheres=ball_rows(scene, spheres),
        rods=as_rows([[*r.start_mm, *r.end_mm, r.radius_mm] for r in rods], 7),
        walls=as_rows(wall_rows(scene, walls), NUMBERS),
        bounds=as_rows(
            [[*s.centre_mm, s.radius_mm + s.uneven_mm] for s in spheres] + [ball_around(r) for r in rods], 4
        ),
        plane=np.ascontiguousarray(plane),  # kernels are compiled for one order of memory
    )
    away_mm = float(abs((np.array(camera.position_mm) - plane[0]) @ plane[3]))
    return SceneTables(world, away_mm / camera.focal_px)


def _camera_numbers(camera: Camera, aperture: Aperture | None) -> NDArray[np.float64]:
    """Numbers of `camera_ray`; `camera` looks along the normal of its sensor, a lens that is tilted does not."""
    lens, focal_px, principal_px = camera.lens, camera.focal_px, np.array(camera.principal_px)
    radius_mm, focus_mm, per_mm, rotation = 0.0, 1.0, 0.0, camera.rotation_matrix
    axes, nearest_mm = np.eye(3), focus_mm
    if aperture is not None:
        radius_mm, focus_mm = aperture.pupil_radius_mm, aperture.focus_mm
        nearest_mm, per_mm = focus_mm, 1.0 / aperture.f_mm - 1.0 / focus_mm
        if any(aperture.sensor_tilt_rad):
            axes = Rotation.from_euler("XY", aperture.sensor_tilt_rad).as_matrix().T
            focal_px = focal_px / axes[2, 2]  # along the axis of the lens, which meets the sensor there
            principal_px = principal_px + focal_px * axes[:2, 2]
            rotation = axes.T @ rotation
            corners = np.array([[u, v] for u in (0, camera.sensor_px[0]) for v in (0, camera.sensor_px[1])])
            back = 1.0 + (corners - principal_px) / focal_px @ axes[:2, 2]
            nearest_mm = float(1.0 / np.abs(1.0 / focus_mm + per_mm * (1.0 - 1.0 / back)).max())
    terms = (lens.k1, lens.k2, lens.k3, lens.p1, lens.p2, radius_mm, focus_mm)
    pose = (focal_px, *principal_px, *camera.position_mm, *rotation.ravel())
    return np.array([*pose, *terms, *axes[:2].ravel(), per_mm, nearest_mm])


def _in_front(
    body: Body, plane: NDArray[np.float64], sheet_mm: tuple[float, float] | None, is_light: bool
) -> bool:
    """True if a body lies before the sheet or reaches past it beside it, False if it is behind.

    Raises
    ------
    SceneError
        The sheet cuts the body.
    """
    if body.may_cross_plane and not isinstance(body, Sphere):
        return True
    ends, radius_mm = body.outline_mm
    radius_mm -= 2.0 * body.uneven_mm  # the least it can be: that a ball is not in the sheet, its scene says
    heights = [float((end - plane[0]) @ plane[3]) for end in ends]
    if min(heights) - radius_mm >= -CONTACT_TOL_MM:
        return True
    if max(heights) + radius_mm <= CONTACT_TOL_MM:
        return False
    if (sheet_mm is not None and _beside(body, plane, sheet_mm)) or (is_light and isinstance(body, Sphere)):
        return True
    raise SceneError(f"the target cuts through body {body.name!r}; move the target back or the body away")


def _beside(body: Body, plane: NDArray[np.float64], sheet_mm: tuple[float, float]) -> bool:
    """Return whether a box around a body, along the sheet's axes, has no point in common with the sheet."""
    *ends, radius_mm = body.capsule
    places = (np.array(ends) - plane[0]) @ plane[1:3].T
    low, high = places.min(axis=0) - radius_mm, places.max(axis=0) + radius_mm
    half = 0.5 * np.array(sheet_mm)
    return bool((low >= half).any() or (high <= -half).any())
