"""A board that hangs turned or leaning before a bench that is as described.

The board at z = 0 is the world (docs/adr/0005), so a board put in 17 degrees askew looks like a camera that
rolled, and one that leans like a camera that moved sideways and turned back.  Such a move is larger than any
camera's and has a mark: camera and position turn together about the board.  With b the turn of the bench as
seen from the board, B its matrix, p0, R0 the nominal camera and p, R the one that the bare board shows,

    min over b   |p - B p0|^2 / sigma_p^2 + |log(R B R0^T)|^2 / sigma_r^2 + |b|^2 / LARGE^2.

The whole bench is turned by it, glass and travel of the stage included: they stand as described, the board
does not.
"""

from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.fit.solve.contact import clear_of, pushed_apart
from tracer.bodies import vector3
from tracer.camera import Camera, Vector3
from tracer.scene.fit_section import FitCameraTable
from tracer.scene.scene import Scene

LARGE_DEG = 30.0


def turn_of_bench(nominal: Camera, seen: Camera, known: FitCameraTable) -> NDArray[np.float64]:
    """Rotation matrix B (3, 3) of the bench, as seen from the board.

    Parameters
    ----------
    nominal, seen : Camera
        As described, and as the bare board shows it.
    known : FitCameraTable
        Sigmas of the camera's pose.
    """
    place, rows = np.array(nominal.position_mm), nominal.rotation_matrix
    spread_mm, spread = max(known.position_mm, 1e-3), np.deg2rad(max(known.rotation_deg, 1e-3))

    def misses(turn: NDArray[np.float64]) -> NDArray[np.float64]:
        bench = scipy.spatial.transform.Rotation.from_rotvec(turn).as_matrix()
        left = scipy.spatial.transform.Rotation.from_matrix(seen.rotation_matrix @ bench @ rows.T).as_rotvec()
        away = np.array(seen.position_mm) - bench @ place
        return np.concatenate((away / spread_mm, left / spread, turn / np.deg2rad(LARGE_DEG)))

    start = scipy.spatial.transform.Rotation.from_matrix(seen.rotation_matrix.T @ rows).as_rotvec()
    return np.asarray(
        scipy.spatial.transform.Rotation.from_rotvec(scipy.optimize.least_squares(misses, start).x).as_matrix()
    )


def turned(scene: Scene, turn: NDArray[np.float64]) -> Scene:
    """Return the scene turned as a whole about the world's origin, its spheres clear of the plane."""

    def point(world: Vector3) -> Vector3:
        x, y, z = turn @ np.array(world)
        return float(x), float(y), float(z)

    a, b, c = ((float(r[0]), float(r[1]), float(r[2])) for r in scene.camera.rotation_matrix @ turn.T)
    camera = replace(scene.camera, position_mm=point(scene.camera.position_mm), rotation=(a, b, c))
    spheres = scene.sphere_table()
    spheres[:, :3] = spheres[:, :3] @ turn.T
    places = map(vector3, pushed_apart(spheres)[:, :3])
    placed = {s.name: replace(s, centre_mm=place) for s, place in zip(scene.spheres, places, strict=True)}
    balls = tuple(placed.values())
    bodies = tuple(
        placed.get(body.name) or (body.moved(point) if body.room else clear_of(body.moved(point), balls))
        for body in scene.bodies
    )
    return replace(scene, camera=camera, bodies=bodies)


def in_words(turn: NDArray[np.float64]) -> str:
    """Say how the board hangs."""
    about_x, about_y, about_z = (
        -np.rad2deg(scipy.spatial.transform.Rotation.from_matrix(turn).as_rotvec())
    ).tolist()
    return (
        f"the board is turned by {about_z:+.1f} deg in its plane and leans by {about_x:+.1f} deg about x and"
        f" {about_y:+.1f} deg about y against the scene; the world follows the board, camera and glass with it"
    )
