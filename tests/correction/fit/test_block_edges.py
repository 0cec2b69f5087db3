"""Edges of boxes found where frames of the independent renderer show them, the file off by a millimetre."""

from dataclasses import replace

import numpy as np
import pytest

from correction.fit.seen.edges_of_blocks import find_edges
from correction.fit.solve.solver import minimise
from correction.fit.solve.unknowns import unknowns_of
from tests.correction.fit.benches import photograph
from tests.correction.fit.test_blocks_found import BASE, BLOCKS, SQUARE_MM
from tests.slow_cases import slow
from tracer.bodies import Box
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


def test_frames_without_a_difference_show_no_edges() -> None:
    truth = replace(BASE, bodies=(BLOCKS["box"],))
    bare, again = (photograph(truth.bare(), False, 0.0, seed, SQUARE_MM) for seed in (31, 32))
    unknowns = unknowns_of(truth, [0.0], FitTable())
    assert find_edges(unknowns, unknowns.start, [(again, bare)], SEARCH_PX) == ()
