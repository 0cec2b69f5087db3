"""When and how a whole sensor is traced in lockstep (``tracer.kernels.chain``).

Lockstep serves scenes of a few transparent spheres that are nowhere optically thinner than the room: every
scene of the paper.  Anything else (supports, opaque balls, bubbles, a whole bed) goes through ``march``,
pixel by pixel.  Both give the same map to rounding; a test holds them together.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tracer.bodies import Sphere
from tracer.kernels.chain import MARKED, chain_rows
from tracer.kernels.march import MAX_EVENTS
from tracer.rows import run_rows
from tracer.scene import Scene
from tracer.trace import Branch, pack_camera, trace

MAX_CHAIN = 8  # each more costs every glass pixel a full sphere; beyond, most spheres are missed by most rays


def fits_lockstep(scene: Scene) -> bool:
    """Whether a scene can be traced in lockstep."""
    table = scene.sphere_table()
    clear = bool((table[:, 4] >= 1.0).all() and not table[:, 5].any())
    return clear and not scene.rods and 1 <= len(table) <= MAX_CHAIN


def trace_lockstep(
    scene: Scene, plane: NDArray[np.float64], status: NDArray[np.uint8], branch: NDArray[np.uint16]
) -> tuple[Branch, ...]:
    """Trace every pixel into plane (H, W, 2), status (H, W) and branch (H, W); return the branches.

    Branch number k < 2^N means: of the N spheres in chain order, those whose bit is set in k.  Branches
    that rays take in another order follow behind.
    """
    height, width = status.shape
    camera = pack_camera(scene.camera)
    chain = _chain(scene)
    constants = tuple(_constants(sphere, scene) for sphere in chain)
    numbers = tuple(float(x) for x in camera)
    table = scene.with_bodies(chain).sphere_table()
    checked, flat = not _stacked(chain), scene.camera.lens.is_ideal

    def work(first: int, last: int) -> None:
        x, y = np.empty(width), np.empty(width)
        spans = np.empty((len(chain) + 1, 2), np.int64)
        bodies, trail = (table, scene.rod_table()), np.empty(MAX_EVENTS, np.int32)
        chain_rows(
            *(camera, numbers, constants, *bodies, trail, checked, flat, first, last, x, y, spans),
            *(plane, status, branch),
        )

    run_rows(work, height)
    names = [sphere.name for sphere in chain]
    branches = [tuple(n for bit, n in enumerate(names) if mask >> bit & 1) for mask in range(1 << len(names))]
    rows, columns = np.nonzero(branch >= MARKED)
    if len(rows):
        again = trace(scene, np.stack((columns, rows), axis=-1))
        plane[rows, columns] = again.plane_mm
        status[rows, columns] = again.rays["status"]
        for key, sequence in sorted(again.branches.items(), key=lambda item: item[1]):
            if sequence not in branches:
                branches.append(sequence)
            taken = again.rays["key"] == key
            branch[rows[taken], columns[taken]] = branches.index(sequence)
    return tuple(branches)


def _constants(sphere: Sphere, scene: Scene) -> tuple[float, ...]:
    """Sphere tuple of ``tracer.kernels.chain``."""
    assert sphere.medium is not None
    n, radius = sphere.medium.n(scene.wavelength_nm) / scene.n_ambient, sphere.radius_mm
    square = radius * radius
    numbers = (
        *sphere.centre_mm,
        square,
        1.0 / square,
        1.0 / (n * n * square),
        1.0 / n,
        (n - 1) * (n + 1) / (n * n),
        1.0 / radius,
    )
    return tuple(float(number) for number in numbers)  # one whole number among them is another type to compile


def _chain(scene: Scene) -> list[Sphere]:
    """Spheres in the order of the lockstep: by height if stacked, else by power about the pinhole; no ties."""
    eye = np.array(scene.camera.position_mm)

    def power_mm2(s: Sphere) -> float:
        return s.distance_mm(eye) * (s.distance_mm(eye) + 2.0 * s.radius_mm)

    by_height = sorted(scene.spheres, key=lambda s: (-s.centre_mm[2], s.centre_mm, s.radius_mm))
    return by_height if _stacked(by_height) else sorted(by_height, key=power_mm2)


def _stacked(chain: list[Sphere]) -> bool:
    """Whether no two spheres share any z, so that every ray going down meets them in this order."""
    return all(low.highest_mm <= high.lowest_mm for high, low in pairwise(chain))
