"""Error of a ray map against the 50-digit reference tracer, by region of the sphere."""

import mpmath
import numpy as np
from mpmath import mpf
from numpy.typing import NDArray

from benchmarks.reference import Seen, follow_pixel
from benchmarks.scenes import aimed_pixels
from tracer.scene.scene import Scene

REGIONS = {"clear": 0.0, "centre": 0.9, "rim": 0.99, "last 1 %": 1.0}
LEVEL = 0.05  # a ray within 3 degrees of level lands anywhere: its conditioning, not the tracer, decides


def reference_pixels(scene: Scene, count: int, seed: int = 4) -> list[tuple[int, int, Seen]]:
    """Pixels u, v, half of them aimed at spheres, and what 50 digits say about them."""
    height, width = scene.camera.shape
    pixels = np.rint(aimed_pixels(scene, np.random.default_rng(seed), count)).astype(int)
    pixels = np.clip(pixels, 0, (width - 1, height - 1))
    return [(u, v, follow_pixel(scene, float(u), float(v))) for u, v in pixels.tolist()]


def errors_um(plane_mm: NDArray[np.float64], known: list[tuple[int, int, Seen]]) -> dict[str, dict[str, float]]:
    """Largest and rms error [um] of a map (H, W, 2) in each region, and how many rays that is."""
    found: dict[str, list[float]] = {name: [] for name in REGIONS}
    for u, v, seen in known:
        if seen.status != "recovered" or abs(seen.direction[2]) < LEVEL:
            continue
        place = next(name for name, limit in REGIONS.items() if seen.worst <= limit)
        x, y = (mpf(float(value)) for value in plane_mm[v, u])
        found[place].append(1e3 * float(mpmath.hypot(x - seen.x, y - seen.y)))
    return {
        name: {
            "rays": len(values),
            "max_um": float(np.max(values)),
            "rms_um": float(np.sqrt(np.mean(np.square(values)))),
        }
        for name, values in found.items()
        if values
    }
