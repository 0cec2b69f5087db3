"""Trace a whole sensor in lockstep (``tracer.kernels.chain``), behind windows or not.

Lockstep serves scenes of a few solid transparent spheres that are nowhere optically thinner than what is around
them: every scene of the paper, spheres in a furnace, a few in a tank of liquid.  What else there is goes by other
ways (``tracer.strategies.strategy``), which give the same map to rounding; tests hold them together.

Branches are numbered beforehand (``tracer.strategies.branches``).  What rays meet in another order than a number
can say is traced again by `trace_ray`, which names it.

A camera that looks straight down on x = 0 (or y = 0) at bodies that are their own mirror image sees a picture
that is its own mirror image, bit for bit: only half of it is traced (``tracer.kernels.sensor``).
"""

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ground.rows import run_rows
from tracer.bodies import Sphere
from tracer.bodies.window import ROW
from tracer.kernels.apparent import FACE
from tracer.kernels.branches import UNKNOWN
from tracer.kernels.chain import (
    BALL,
    RAY_NUMBERS,
    SKIP_LEFT_BEHIND,
    SKIP_LONE,
    SKIP_SILHOUETTES,
    TRIP_NUMBERS,
)
from tracer.kernels.packets import LANES, VECTOR
from tracer.kernels.sensor import MapArrays, Mirrors, RowOptions, RowScratch, sensor_rows
from tracer.kernels.windowed import WindowScratch, rows_behind_windows
from tracer.scene.scene import Scene
from tracer.strategies.branches import Branch, Numbers, chain, chain_branches, mirror_numbers, number_in
from tracer.strategies.trace import pack_camera, trace

NO_WINDOWS = np.empty((0, len(ROW)))
MAX_CHAIN = 8  # from here on most spheres are missed by most rays, and 2^N branches become a long list
LONE_STEPS = 128  # angles of incidence for which rays behind a sphere are compared with the others
LINE = 64  # bytes of a cache line
SKIP_MIRRORED = 4
ALL_SKIPS = SKIP_SILHOUETTES | SKIP_LEFT_BEHIND | SKIP_MIRRORED | SKIP_LONE
STRAIGHT_DOWN = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))


def trace_lockstep(
    scene: Scene,
    plane: NDArray[np.float64 | np.float32],
    status: NDArray[np.uint8],
    branch: Numbers,
    skips: int = ALL_SKIPS,
    windows: NDArray[np.float64] = NO_WINDOWS,
) -> tuple[Branch, ...]:
    """Trace every pixel into plane (H, W, 2), status (H, W) and branch (H, W).

    Parameters
    ----------
    scene : Scene
        A few solid transparent spheres.
    plane, status, branch : arrays (H, W, 2), (H, W), (H, W)
        What is written.
    skips : int
        What may be passed over without a look.  The result has the same bits for any; behind windows, the same to
        rounding.
    windows : (K, 10) float64
        Windows in front of all spheres, from the camera on (``tracer.kernels.window``).

    Returns
    -------
    tuple of Branch
        The branches that are numbered.
    """
    height, width = status.shape
    camera, balls, flat = pack_camera(scene.camera), pack_chain(scene), scene.camera.lens.is_ideal
    mirrors = find_mirrors(scene, windows)
    paired = len(mirrors.swap_x) + len(mirrors.swap_y) > 0
    if not skips & SKIP_MIRRORED:
        mirrors = NO_MIRRORS
    unknown, out = np.zeros(height, np.int64), MapArrays(plane.reshape(height, 2 * width), status, branch)
    options = RowOptions(flat, paired, skips)
    discs = lone_discs(camera, balls) if flat and len(balls) > 1 and len(windows) == 0 else balls
    spare = deque[RowScratch]()

    def work(first: int, last: int) -> None:
        try:
            scratch = spare.pop()
        except IndexError:
            scratch = row_scratch(width, len(balls))
        if len(windows) == 0:
            sensor_rows((camera, balls, discs), options, mirrors, first, last, scratch, unknown, out)
            spare.append(scratch)
            return
        behind = WindowScratch(
            scratch,
            np.empty(LANES + VECTOR, np.int64),
            np.empty(4),
            np.empty((2 * len(windows), FACE)),
            np.empty((len(balls), 4)),
        )
        rows_behind_windows((camera, balls, windows), options, mirrors, first, last, behind, unknown, out)

    run_rows(work, (height + 1) // 2 if mirrors.in_y else height)
    branches = chain_branches(scene)
    name_unknown(scene, np.nonzero(unknown)[0], branches, plane, status, branch)
    return tuple(branches)


def lone_discs(camera: NDArray[np.float64], balls: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return `balls` (N, BALL) with the square of a distance b for R^2: rays closer meet no ball behind this one.

    With the symbols of ``tracer.kernels.chain``, b = R sin psi, and alpha the angle between a ray and the axis u
    from pinhole to centre: theta = delta - alpha, and of coordinates (aside on the ray's side, along u) the
    direction behind the sphere is (-sin theta, cos theta), the foot point b (cos theta, sin theta).  A centre at s
    along u and a aside, in a plane turned by phi, stands closest to the ray at phi = 0 or pi: the square of the
    distance is concave in cos phi, and where the ray does not approach, it is beyond the foot point, as spheres do
    not overlap.  There it is |+-a cos theta + s sin theta - b|, and ahead is s cos theta -+ a sin theta > 0.
    Steps of psi are compared in their middle, bounds widened by what half a step can change.
    """
    centres, radius = balls[:, :3], np.sqrt(balls[:, 3])
    axis = centres - camera[:3]
    length = np.sqrt((axis * axis).sum(axis=1))
    half = 0.25 * np.pi / LONE_STEPS
    psi = half * np.arange(1, 2 * LONE_STEPS, 2)
    b = radius[:, None] * np.sin(psi)  # (N, steps)
    theta = 2.0 * (psi - np.arcsin(np.sin(psi) * balls[:, 6:7])) - np.arcsin(b / length[:, None])
    sine, cosine = np.sin(theta)[:, None], np.cos(theta)[:, None]
    c = centres - centres[:, None]  # (N, others, 3)
    away = np.sqrt((c * c).sum(axis=2))
    along = (c * axis[:, None]).sum(axis=2) / length[:, None]
    aside = np.sqrt(np.maximum(away * away - along * along, 0.0))
    rate = half * np.maximum(2.0, radius / np.sqrt(length**2 - balls[:, 3]))  # of theta in half a step, at most
    slack = away * rate[:, None]
    reach = radius + slack + (radius * half)[:, None]
    meets = np.zeros((len(balls), len(balls), LONE_STEPS), np.bool_)
    for side in (-aside, aside):
        ahead = along[..., None] * cosine - side[..., None] * sine > -slack[..., None]
        meets |= ahead & (abs(side[..., None] * cosine + along[..., None] * sine - b[:, None]) < reach[..., None])
    meets[np.arange(len(balls)), np.arange(len(balls))] = False
    first = np.minimum.reduce(np.where(meets, np.arange(LONE_STEPS), LONE_STEPS), axis=(1, 2))
    discs = balls.copy()
    discs[:, 3] *= np.sin(2.0 * half * first) ** 2
    return discs


NO_MIRRORS = Mirrors(False, False, np.empty(0, np.int64), np.empty(0, np.int64))


def find_mirrors(scene: Scene, windows: NDArray[np.float64] = NO_WINDOWS) -> Mirrors:
    """Mirrors of a scene, behind windows (K, 10).  Numbers must agree to the last bit: nearly is not symmetric."""
    camera, rows = scene.camera, [_constants(sphere, scene) for sphere in chain(scene)]
    if camera.rotation != STRAIGHT_DOWN or not camera.lens.is_ideal:
        return NO_MIRRORS
    there, images = [], []
    for axis in (0, 1):
        places = [(*row[:axis], -row[axis], *row[axis + 1 :]) for row in rows]
        symmetric = camera.position_mm[axis] == 0.0 and set(places) == set(rows)
        symmetric = symmetric and not windows[:, (axis, 3 + axis)].any()
        there.append(symmetric and camera.principal_px[axis] == (camera.sensor_px[axis] - 1) / 2.0)
        images.append([rows.index(place) if there[axis] else k for k, place in enumerate(places)])
    swap_x, swap_y = map(mirror_numbers, images)
    return Mirrors(there[0], there[1], swap_x, swap_y)


def row_scratch(width: int, bodies: int) -> RowScratch:
    """Memory of one thread for the kernels in ``tracer.kernels.sensor``."""
    spans, wanted = np.empty((3 * bodies + 1, 2), np.int64), np.empty(bodies, np.int64)
    x, y = cache_aligned(width + VECTOR, np.float64), cache_aligned(width + VECTOR, np.float64)
    return RowScratch(x, y, spans, wanted, *block_scratch())


def name_unknown(
    scene: Scene,
    lines: NDArray[np.int64],
    branches: list[Branch],
    plane: NDArray[np.float64 | np.float32],
    status: NDArray[np.uint8],
    branch: Numbers,
) -> None:
    """Trace the pixels without a branch number, all in the rows `lines`, one by one and append their branches."""
    rows, columns = np.nonzero(branch[lines] == UNKNOWN)
    rows = lines[rows]
    if len(rows):
        places = rows, columns
        plane[places], status[places], branch[places] = trace_numbered(
            scene, np.stack((columns, rows), -1), branches
        )


def trace_numbered(
    scene: Scene, pixels: NDArray[np.int64], branches: list[Branch]
) -> tuple[NDArray[np.float64], NDArray[np.uint8], NDArray[np.uint16]]:
    """Plane points, status and branch numbers of pixels (N, 2); branches not among `branches` are appended."""
    again = trace(scene, pixels)
    numbers = np.empty(len(pixels), np.uint16)
    for key, sequence in sorted(again.branches.items(), key=lambda item: item[1]):
        numbers[again.rays["key"] == key] = number_in(branches, sequence)
    return again.plane_mm, again.rays["status"], numbers


def block_scratch() -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Scratch ``rays`` and ``trips`` of one block."""
    return cache_aligned(RAY_NUMBERS, np.float64), cache_aligned(TRIP_NUMBERS, np.int64)


def pack_chain(scene: Scene) -> NDArray[np.float64]:
    """Spheres for ``tracer.kernels.chain`` (N, BALL), from the highest centre down."""
    return np.array([_constants(sphere, scene) for sphere in chain(scene)]).reshape(-1, BALL)


def sphere_discs(table: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows of ``balls`` (N, BALL) in the order of a sphere table with all that a silhouette needs."""
    discs = np.zeros((len(table), BALL))
    discs[:, :3], discs[:, 3] = table[:, :3], table[:, 3] ** 2
    return discs


def cache_aligned(count: int, dtype: type) -> NDArray[Any]:
    """Uninitialised numbers of 8 bytes that begin at a cache line: vectors across two lines cost twice."""
    memory = np.empty(8 * count + LINE, np.uint8)
    start = -memory.__array_interface__["data"][0] % LINE  # `ctypes` takes as long as a row
    return memory[start : start + 8 * count].view(dtype)


def _constants(sphere: Sphere, scene: Scene) -> tuple[float, ...]:
    """Row of ``balls`` of ``tracer.kernels.chain``."""
    assert sphere.medium is not None
    n, radius = sphere.medium.n(scene.wavelength_nm) / scene.n_around(sphere), sphere.radius_mm
    square = radius * radius
    numbers = (
        *sphere.centre_mm,
        square,
        1.0 / square,
        1.0 / (n * n * square),
        1.0 / n,
        (n - 1) * (n + 1) / (n * n),
        1.0 / radius,
        sphere.lowest_mm,
        sphere.highest_mm,
    )
    assert len(numbers) == BALL
    return numbers
