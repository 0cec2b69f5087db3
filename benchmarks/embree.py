"""Beds by Embree: the tree that everybody's renderer uses, with triangles in float32, beside our bundles.

    python -m benchmarks.embree 16 128 1000        needs: pip install embreex trimesh

Driven as its users drive it from Python: all rays of the sensor go to Embree at once, for the nearest triangle;
numpy bends them there, with the exact normal of the ball that was hit, and all that still fly go again.  The
processor time counts both; how much of it is Embree's own is said beside.
"""

import sys
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.growth import core_ms, with_pixels
from benchmarks.scenes import bed
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import build_ray_map

HALVINGS = 3  # of an icosahedron: 1280 triangles a ball
CLEAR_MM = 1e-3  # float32 at half a metre knows 3e-5: a ray begins that far behind the surface it left
MOST_SURFACES = 64


class Embree:
    """A scene of spheres in Embree."""

    def __init__(self, scene: Scene) -> None:
        import trimesh
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        table = scene.sphere_table()
        self._centres, self._radii, self._n = table[:, :3], table[:, 3], table[:, 4]
        ball = trimesh.creation.icosphere(HALVINGS)
        corners = np.asarray(ball.vertices)[np.asarray(ball.faces)]
        self._each = len(corners)
        triangles = np.concatenate(
            [c + r * corners for c, r in zip(self._centres, self._radii, strict=True)]
        ).astype(np.float32)
        self._world = EmbreeScene()
        TriangleMesh(self._world, triangles)
        self.own_s = 0.0

    def plane_mm(self, start: NDArray[np.float64], ways: NDArray[np.float64]) -> NDArray[np.float64]:
        """Plane points (N, 2) of rays from one point; NaN for those that do not arrive."""
        p, d = np.broadcast_to(start, ways.shape).copy(), ways.copy()
        flying, lost = np.arange(len(ways)), np.zeros(len(ways), bool)
        for _ in range(MOST_SURFACES):
            begun_s = time.process_time()
            found: dict[str, Any] = self._world.run(
                p[flying].astype(np.float32), d[flying].astype(np.float32), output=1
            )
            self.own_s += time.process_time() - begun_s
            met = found["primID"] >= 0
            flying, t, ball = (
                flying[met],
                found["tfar"][met].astype(np.float64),
                found["primID"][met] // self._each,
            )
            if not len(flying):
                break
            q = p[flying] + t[:, None] * d[flying]
            normal = (q - self._centres[ball]) / np.linalg.norm(q - self._centres[ball], axis=1, keepdims=True)
            cosine = -(normal * d[flying]).sum(axis=1)
            eta = np.where(cosine > 0.0, 1.0 / self._n[ball], self._n[ball])
            normal *= np.sign(cosine)[:, None]
            cosine = np.abs(cosine)
            square = 1.0 - eta**2 * (1.0 - cosine**2)
            lost[flying[square <= 0.0]] = True
            bent = eta[:, None] * d[flying] + (eta * cosine - np.sqrt(np.maximum(square, 0.0)))[:, None] * normal
            d[flying] = bent / np.linalg.norm(bent, axis=1, keepdims=True)
            p[flying] = q + CLEAR_MM * d[flying]
            flying = flying[square > 0.0]
        plane = p[:, :2] - p[:, 2:] / d[:, 2:] * d[:, :2]
        plane[lost | (d[:, 2] >= 0.0)] = np.nan
        return plane


def main(counts: list[int], factor: float = 0.25) -> None:
    """Print processor time a covered pixel of both, and how far apart their points are."""
    for count in counts:
        scene = with_pixels(bed(count), factor)
        embree = Embree(scene)
        height, width = scene.camera.shape
        v, u = np.mgrid[0:height, 0:width]
        ways = scene.camera.directions(np.stack((u.ravel(), v.ravel()), axis=1).astype(np.float64))
        start = np.array(scene.camera.position_mm)
        ours = build_ray_map(scene)
        ours_ms = core_ms(lambda s=scene: build_ray_map(s))  # type: ignore[misc]
        embree_ms = core_ms(lambda e=embree, w=ways, s=start: e.plane_mm(s, w))  # type: ignore[misc]
        embree.own_s = 0.0
        theirs = embree.plane_mm(start, ways).reshape(height, width, 2)
        both = np.isfinite(theirs[..., 0]) & ours.recovered & (ours.branch > 0)
        apart = np.linalg.norm(theirs - ours.plane_mm, axis=2)[both] * scene.camera.focal_px / start[2]
        covered = int((ours.branch > 0).sum())
        print(
            f"{count} balls, {width} x {height} px, {covered} covered: ours {1e3 * ours_ms / covered:.3f} us a"
            f" covered pixel, Embree {1e3 * embree_ms / covered:.3f} ({1e6 * embree.own_s / covered:.3f} its own),"
            f" {embree_ms / ours_ms:.1f} times; points apart: median {np.median(apart):.4f} px,"
            f" 99 % {np.percentile(apart, 99.0):.3f} px"
        )


if __name__ == "__main__":
    main([int(word) for word in sys.argv[1:]] or [16, 128, 1000])
