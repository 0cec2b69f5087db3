"""Edges of boxes found where frames of the independent renderer show them, the file off by a millimetre."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from correction.fit.seen.edges_of_blocks import find_edges
from correction.fit.seen.measurement import TargetFrame
from correction.fit.solve.solver import minimise
from correction.fit.solve.unknowns import unknowns_of
from tests.correction.fit.benches import photograph
from tests.correction.fit.test_blocks_found import BASE, BLOCKS, GLASS, SQUARE_MM
from tests.slow_cases import slow
from tracer.bodies import Box
from tracer.bodies.block import UNTURNED, rectangle, rotate_axes
from tracer.scene.fit_section import FitTable, FitWallTable
from tracer.scene.scene import Scene

SEARCH_PX = 80.0
OFF_MM = 1.0


def outline_distance_px(scene: Scene, ends: tuple[int, int], pixel: tuple[float, float]) -> float:
    """Distance of a pixel from the line between two projected corners of the only body."""
    (body,) = scene.bodies
    assert isinstance(body, Box)
    one, other = scene.camera.project_ideal(body.corners_mm[list(ends)])
    (x, y), (ax, ay) = (other - one) / np.linalg.norm(other - one), np.array(pixel) - one
    return float(abs(x * ay - y * ax))


@pytest.mark.parametrize("seed", [21, slow(22)])
def test_edges_of_a_box_are_found_a_millimetre_beside_their_file(seed: int) -> None:
    rng = np.random.default_rng(seed)
    box = BLOCKS["box"]
    truth = replace(BASE, bodies=(box,))
    way = rng.normal(size=2)
    aside = OFF_MM * way / np.linalg.norm(way)
    believed = replace(box, centre_mm=(box.centre_mm[0] + aside[0], box.centre_mm[1] + aside[1], box.centre_mm[2]))
    bare = photograph(truth.bare(), False, 0.0, seed, SQUARE_MM)
    glass = photograph(truth, True, 0.0, seed + 9, SQUARE_MM)
    priors = FitTable(walls=FitWallTable(place_mm=1.0))
    unknowns = unknowns_of(replace(truth, bodies=(believed,)), [0.0], priors)
    edges = find_edges(unknowns, unknowns.start, [(glass, bare)], SEARCH_PX)
    assert len(edges) >= 6
    px = 1.0 / truth.camera.focal_px
    for edge in edges:
        assert outline_distance_px(truth, edge.ends, edge.pixel) < min(4.0 * edge.sigma_rad / px, 0.5)
    own = replace(unknowns, edges=edges).only(["box.x", "box.y"])
    found = own.full(minimise(own, lambda _: [], np.zeros(2), knee=3.0).x)[own.others][:2]
    assert np.abs(found - box.centre_mm[:2]).max() < 0.03  # of the 1 mm


def chipped(scene: Scene, glass: TargetFrame, bare: TargetFrame, rng: np.random.Generator) -> TargetFrame:
    """Chips of 3 to 9 px along the outline, 25 a side, through which the bare board is seen."""
    image, (body,) = glass.image.copy(), scene.bodies
    assert isinstance(body, Box)
    outline = cv2.convexHull(scene.camera.project(body.corners_mm).astype(np.float32))[:, 0]
    v, u = np.indices(image.shape)
    for one, other in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        for share, radius in zip(rng.uniform(0.0, 1.0, 25), rng.uniform(3.0, 9.0, 25), strict=True):
            x, y = one + share * (other - one)
            chip = np.hypot(u - x, v - y) < radius
            image[chip] = bare.image[chip]
    return replace(glass, image=image)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["chipped", "beyond the frame"])
def test_edges_that_are_chipped_or_lie_beyond_the_frame_are_right_or_left_out(kind: str) -> None:
    rng = np.random.default_rng((41, 5))
    box = BLOCKS["box"]
    if kind != "chipped":  # a plate over half of the view; a side is predicted in the frame, and lies 22 px beyond
        turned = rotate_axes(UNTURNED, (0.03, 0.05, 0.02))
        box = Box("box", rectangle(120.0, 160.0), 2.0, GLASS, (-62.0, 0.0, 40.0), turned)
    truth = replace(BASE, bodies=(box,))
    x, y = rng.normal(size=2)
    far = OFF_MM / float(np.hypot(x, y))
    believed = replace(box, centre_mm=(box.centre_mm[0] + far * x, box.centre_mm[1] + far * y, box.centre_mm[2]))
    bare = photograph(truth.bare(), False, 0.0, 41, SQUARE_MM)
    glass = photograph(truth, True, 0.0, 50, SQUARE_MM)
    if kind == "chipped":
        glass = chipped(truth, glass, bare, rng)
    unknowns = unknowns_of(replace(truth, bodies=(believed,)), [0.0], FitTable(walls=FitWallTable(place_mm=1.0)))
    for edge in find_edges(unknowns, unknowns.start, [(glass, bare)], SEARCH_PX):
        off_px = outline_distance_px(truth, edge.ends, edge.pixel)
        assert off_px < 4.0 * edge.sigma_rad * truth.camera.focal_px


@pytest.mark.slow
def test_frames_without_a_difference_show_no_edges() -> None:
    truth = replace(BASE, bodies=(BLOCKS["box"],))
    bare, again = (photograph(truth.bare(), False, 0.0, seed, SQUARE_MM) for seed in (31, 32))
    unknowns = unknowns_of(truth, [0.0], FitTable())
    assert find_edges(unknowns, unknowns.start, [(again, bare)], SEARCH_PX) == ()
