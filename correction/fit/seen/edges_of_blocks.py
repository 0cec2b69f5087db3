"""Edges of blocks in the frame: where the view of the bare board ends.

Outside the outline of a block a frame with the glass shows what the bare frame of the same pose shows, and inside
it something else.  Each side of the outline is found in two steps.  First the line

    t = a + b s,        s along the predicted side, t across it and inwards [px],

from which on the two frames differ: the sum over all pixels inside it of min(z^2 / 2, MOST_GAIN) - EVEN_GAIN is
largest, z the difference in sigmas of the noise.  Then the light G of the frame beside that line is fitted by

    G = B + F((t - a - b s) / w) (e - B),

B the bare frame, F the normal distribution, w the blur and e the light of the ground edge, one for each short
piece of the side: it may glint or be dark.  For each a, b, w the e follow by linear least squares; pieces in which
e is as bright as the board tell nothing, by themselves.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.fit.seen.measurement import TargetFrame
from correction.fit.solve.block_edges import EdgePoint, angles_beside, edge_rates
from correction.fit.solve.unknowns import Unknowns
from tracer.bodies import Block
from tracer.scene.scene import Scene
from tracer.strategies.branches import DIRECT
from tracer.strategies.trace import trace

# How far from its predicted place a side is looked for
SEARCH_SIGMAS = 4.0
LEAST_PX = 4.0
MOST_GAIN = 12.5  # of z^2 / 2: one pixel counts no more
EVEN_GAIN = 2.0  # below this it is taken for undisturbed
# Beside a line that is fitted, and pieces of one brightness
OUTSIDE_PX = 6.0
INSIDE_PX = 3.0
PIECE_PX = 6.0
WHOLE_SHARE = 0.5  # of the pixels outside a piece, that the frame must hold
# Of a side that can be fitted
MIN_LENGTH_PX = 30.0
MIN_PIXELS = 100
END_PX = 6.0  # left out at both ends of a side, beside what it may move
# Width of a ground edge as seen, below which the light of the face mixes in
NARROW_PX = 1.5
NARROW_EDGE_PX = 0.3
OTHER_EDGE_PX = 1.5  # another edge so near could be the one that is seen
EDGE_FLOOR_PX = 0.05  # ground edges are not straight, and pixels not even, to better
LEAST_INSIDE_PX = 1.0
NOISE_BINS = 6
# Blur
WIDEST_BLUR_PX = 4.0
NARROWEST_BLUR_PX = 0.3
FIRST_BLUR_PX = 0.7
KNEE = 3.0  # sigmas of a pixel
DISTURBED, MOST_DISTURBED = 4.0, 0.15  # sigmas of a pixel outside a side, and share of these at most
PATCH_PX = 24.0  # along a side, over which dirt and chips are alike
MIN_STEP_SIGMAS = 10.0  # of the light at a side, from which it is seen


class Strip(NamedTuple):
    """Pixels beside one side of an outline, N of them: s and t [px], both frames, noise of their difference."""

    along: NDArray[np.float64]
    inward: NDArray[np.float64]
    bare: NDArray[np.float64]
    glass: NDArray[np.float64]
    sigma: NDArray[np.float64]

    def take(self, which: NDArray[np.bool_]) -> "Strip":
        """Return the chosen pixels."""
        return Strip(*(part[which] for part in self))


def find_edges(
    unknowns: Unknowns, full: NDArray[np.float64], pairs: Sequence[tuple[TargetFrame, TargetFrame]], most_px: float
) -> tuple[EdgePoint, ...]:
    """Find the edges of all blocks that stand only in frames with glass.

    Parameters
    ----------
    unknowns : Unknowns
    full : (F,) float64
        Where to begin.
    pairs : sequence of (TargetFrame, TargetFrame)
        Frames with glass, and those of the bare board in the same pose.
    most_px : float
        How far from its predicted place a side may be, at most.
    """
    if all(block.stays for block in Block.among(unknowns.scene.bodies)):
        return ()  # other bodies may overlap while they are sought, which no scene may have
    found = unknowns.other_bodies.bodies_at(full[unknowns.others])
    bodies = tuple(found.get(body.name, body) for body in unknowns.scene.bodies)
    scene = replace(unknowns.scene, camera=unknowns.camera(full), bodies=bodies)
    points: list[EdgePoint] = []
    for (glass, bare), block in itertools.product(pairs, Block.among(scene.bodies)):
        if not block.stays and scene.in_camera_room(block) and glass.image.shape == bare.image.shape:
            noise = _noise_of(glass.image, bare.image)
            for ends in outline_edges(scene, block):
                points += _points_of(unknowns, full, scene, block, ends, most_px, (glass.image, bare.image, noise))
    return tuple(points)


def outline_edges(scene: Scene, block: Block) -> Iterator[tuple[int, int]]:
    """Pairs of corners that the outline of a block joins, seen in front of the plane and clear of other edges."""
    corners = block.corners_mm
    seen = scene.camera.project_ideal(corners)
    if not np.isfinite(seen).all():
        return
    hull = scipy.spatial.ConvexHull(seen).vertices.tolist()
    for one, other in zip(hull, hull[1:] + hull[:1], strict=True):
        if min(corners[one, 2], corners[other, 2]) <= 0.0:
            continue
        way = seen[other] - seen[one]
        inward = np.array([-way[1], way[0]]) / np.linalg.norm(way)
        depth = np.sort((seen - seen[one]) @ inward)  # both ends first
        if depth[2] > OTHER_EDGE_PX:
            yield one, other


def _noise_of(glass: NDArray[Any], bare: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Brightness of the bare frame, and the noise of the difference there, by its smaller half."""
    light, off = bare.ravel().astype(np.float64), np.abs(glass.ravel().astype(np.float64) - bare.ravel())
    limits = np.quantile(light, np.linspace(0.0, 1.0, NOISE_BINS + 1))
    bins = [(light >= low) & (light <= high) for low, high in itertools.pairwise(limits)]
    noise = [float(np.median(off[which])) / 0.6745 for which in bins]
    order = np.array([float(np.median(light[which])) for which in bins])
    keep = np.concatenate(([True], np.diff(order) > 0.0))
    return order[keep], np.maximum(np.array(noise)[keep], 0.3)


def _points_of(
    unknowns: Unknowns, full: NDArray[np.float64], scene: Scene, block: Block, ends: tuple[int, int],
    most_px: float, images: tuple[NDArray[Any], NDArray[Any], tuple[NDArray[np.float64], NDArray[np.float64]]],
) -> list[EdgePoint]:  # fmt: skip
    """Two points of one side of an outline, whose errors are independent; none if the side is not seen."""
    camera = scene.camera
    start, end = camera.project(block.corners_mm[list(ends)])
    length = float(np.linalg.norm(end - start))
    if not length > MIN_LENGTH_PX:
        return []
    way = (end - start) / length
    inward = np.array([-way[1], way[0]])
    middle = start + 0.5 * length * way
    if np.sign(angles_beside(camera, block, ends, (middle + inward)[None])) != np.sign(
        angles_beside(camera, block, ends, camera.project(block.corners_mm.mean(axis=0))[None])
    ):
        inward = -inward
    rad_per_px = abs(
        float(np.diff(angles_beside(camera, block, ends, middle + np.array([[0.0], [1.0]]) * inward))[0])
    )
    x = unknowns.free(full)
    ground_px = min(float((_inside_ground_edge(scene, block, ends) - middle) @ inward), INSIDE_PX)
    there = replace(unknowns, edges=(EdgePoint(block.name, ends, (middle[0], middle[1]), rad_per_px),))
    own_px = float(np.linalg.norm(edge_rates(there, x)[1]))
    reach = float(np.clip(SEARCH_SIGMAS * own_px, LEAST_PX, most_px))
    strip = _strip(scene, block, (start, way, inward, length), reach, images)
    strip = strip.take((strip.along > END_PX + reach) & (strip.along < length - END_PX - reach))
    if len(strip.along) < MIN_PIXELS or float(np.ptp(strip.along)) < MIN_LENGTH_PX:
        return []
    line = _coarse_line(strip, reach)
    found = _fine_line(strip, line, max(ground_px, LEAST_INSIDE_PX))
    if found is None:
        return []
    places, sigma = found
    sigma = float(np.hypot(sigma, EDGE_FLOOR_PX if ground_px > NARROW_PX else NARROW_EDGE_PX))
    return [
        EdgePoint(block.name, ends, tuple((start + s * way + t * inward).tolist()), sigma * rad_per_px)
        for s, t in places
    ]


def _inside_ground_edge(scene: Scene, block: Block, ends: tuple[int, int]) -> NDArray[np.float64]:
    """Pixel (2,) of the inner border of a ground edge at its middle, on the face that the camera sees."""
    one, other = block.corners_mm[list(ends)]
    middle, centre, eye = 0.5 * (one + other), np.array(block.centre_mm), np.array(scene.camera.position_mm)
    off = np.abs((block.corners_mm[list(ends)] - centre) @ block.normals.T - block.own_faces[1]).max(axis=0)
    seen = block.normals @ (eye - middle) > 0.0
    normal = block.normals[int(np.argmin(np.where(seen, off, np.inf)))]
    inward = np.cross(normal, other - one)
    inward *= np.sign(inward @ (centre - middle)) / np.linalg.norm(inward)
    return np.asarray(scene.camera.project(middle + block.edge_mm * inward))


def _strip(
    scene: Scene, block: Block, side: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], float],
    reach: float, images: tuple[NDArray[Any], NDArray[Any], tuple[NDArray[np.float64], NDArray[np.float64]]],
) -> Strip:  # fmt: skip
    """Pixels near a side, where the board is seen directly but for the block itself."""
    (start, way, inward, length), (glass, bare, (light, noise)) = side, images
    far = reach + OUTSIDE_PX
    box = np.array([start + s * way + t * inward for s in (0.0, length) for t in (-far, far)])
    (u0, v0), (u1, v1) = np.floor(box.min(axis=0)).astype(int), np.ceil(box.max(axis=0)).astype(int)
    height, width = bare.shape
    u, v = np.meshgrid(
        np.arange(max(u0, 0), min(u1, width - 1) + 1), np.arange(max(v0, 0), min(v1, height - 1) + 1)
    )
    pixels = np.stack((u.ravel(), v.ravel()), axis=-1)
    off = pixels - start
    pixels = pixels[(np.abs(off @ inward) < far) & (off @ way > 0.0) & (off @ way < length)]
    others = [body for body in scene.bodies if body is not block]
    if others and len(pixels):
        seen = trace(scene.with_bodies(others), pixels.astype(np.float64))
        pixels = pixels[seen.recovered & (seen.rays["key"] == DIRECT)]
    off = pixels - start
    b, g = (image[pixels[:, 1], pixels[:, 0]].astype(np.float64) for image in (bare, glass))
    return Strip(off @ way, off @ inward, b, g, np.interp(b, light, noise))


def _coarse_line(strip: Strip, reach: float) -> tuple[float, float]:
    """Line a, b from which on inwards the frames differ."""
    z2 = 0.5 * ((strip.glass - strip.bare) / strip.sigma) ** 2
    gain = np.minimum(z2, MOST_GAIN) - EVEN_GAIN
    middle = 0.5 * (strip.along.min() + strip.along.max())
    half = 0.5 * max(float(np.ptp(strip.along)), 1.0)
    pieces = np.clip(np.round((strip.along - middle) / PIECE_PX), -1e6, 1e6).astype(int)
    pieces -= pieces.min()
    far = int(np.ceil(reach + OUTSIDE_PX))
    rows = np.clip(np.floor(strip.inward + far).astype(int), 0, 2 * far)
    table = np.zeros((pieces.max() + 1, 2 * far + 2))
    np.add.at(table, (pieces, rows), gain)
    beyond = np.cumsum(table[:, ::-1], axis=1)[:, ::-1]  # gain of all from this row inwards
    centres = np.bincount(pieces, strip.along - middle) / np.maximum(np.bincount(pieces), 1)
    best, line = -np.inf, (0.0, 0.0)
    every = np.arange(len(table))
    for rise in np.arange(-reach, reach + 0.5, 1.0):
        slope = 0.5 * rise / half
        for at in np.arange(-reach, reach + 0.5, 1.0):
            row = np.clip(np.round(at + slope * centres + far).astype(int), 0, 2 * far + 1)
            score = float(beyond[every, row].sum())
            if score > best:
                best, line = score, (float(at - slope * middle), float(slope))
    return line


def _fine_line(
    strip: Strip, line: tuple[float, float], inside_px: float
) -> tuple[list[tuple[float, float]], float] | None:
    """Two points s, t of the line of the light's step, and their sigma [px]; None if there is none."""
    for _ in range(3):  # pixels are chosen about the last line
        depth = strip.inward - line[0] - line[1] * strip.along
        piece = (strip.along // PIECE_PX).astype(int)
        piece -= piece.min()
        # Where the frame ends before the board beside the block is seen, its own border would pass for a side
        whole = np.bincount(piece, (depth > -OUTSIDE_PX) & (depth < 0.0)) > WHOLE_SHARE * OUTSIDE_PX * PIECE_PX
        chosen = (depth > -OUTSIDE_PX) & (depth < inside_px) & whole[piece]
        near, piece = strip.take(chosen), piece[chosen]
        if len(near.along) < MIN_PIXELS or float(np.ptp(near.along)) < MIN_LENGTH_PX:
            return None
        middle, spread = float(near.along.mean()), float(near.along.std())

        def residual(
            numbers: NDArray[np.float64], near: Strip = near, middle: float = middle, spread: float = spread,
            piece: NDArray[np.int64] = piece,
        ) -> NDArray[np.float64]:  # fmt: skip
            first, last, blur = numbers
            at = 0.5 * (first + last) + 0.5 * (last - first) * (near.along - middle) / spread
            share = scipy.special.ndtr((near.inward - at) / blur) / near.sigma
            rest = (near.glass - near.bare) / near.sigma + share * near.bare
            weight = np.bincount(piece, share * share)
            light = np.bincount(piece, share * rest) / np.maximum(weight, 1e-12)
            return np.asarray(rest - light[piece] * share)

        first, last = (line[0] + line[1] * (middle + sign * spread) for sign in (-1.0, 1.0))
        box = ((first - 3.0, last - 3.0, NARROWEST_BLUR_PX), (first + 3.0, last + 3.0, WIDEST_BLUR_PX))
        fit = scipy.optimize.least_squares(
            residual, (first, last, FIRST_BLUR_PX), bounds=box, loss="soft_l1", f_scale=KNEE
        )
        first, last, _ = fit.x
        line = (
            float(0.5 * (first + last) - 0.5 * (last - first) * middle / spread),
            float(0.5 * (last - first) / spread),
        )
    left = residual(fit.x)
    undisturbed = (near.glass - near.bare) / near.sigma
    depth, blur = near.inward - line[0] - line[1] * near.along, float(fit.x[2])
    beyond = np.abs(undisturbed[depth < -2.0 * blur]) > DISTURBED
    if beyond.size and beyond.mean() > MOST_DISTURBED:  # the view ends farther out in places
        return None
    worth = float(undisturbed @ undisturbed - left @ left)
    factor = max(float(np.sqrt(np.mean(left**2))), 1.0)
    if worth < (MIN_STEP_SIGMAS * factor) ** 2:
        return None
    inverse = np.linalg.pinv(fit.jac.T @ fit.jac)
    # Dirt and chips are wider than pixels: what pieces of the side pull the line by, each as a whole (soft_l1)
    pull = fit.jac * (left * (1.0 + (left / KNEE) ** 2) ** 0.25)[:, None]
    patch = ((near.along - near.along.min()) // PATCH_PX).astype(int)
    pulls = np.array([pull[patch == own].sum(axis=0) for own in range(patch.max() + 1)]) @ inverse
    count = max(len(pulls), 4)
    variance = np.maximum(factor**2 * np.diag(inverse), count / (count - 3) * (pulls**2).sum(axis=0))
    sigma = float(np.sqrt(variance[:2].max()))
    if not sigma < 1.0:
        return None
    return [(middle - spread, float(first)), (middle + spread, float(last))], sigma
