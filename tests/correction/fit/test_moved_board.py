"""A bent board is followed by derivatives that are those of its residuals, and found after a camera went aside."""

import re

import numpy as np
import pytest

from correction.fit.seen.measurement import whitening
from correction.fit.solve.moved_board import on_moved_board
from correction.fit.solve.solver import Corners
from correction.fit.solve.unknowns import unknowns_of
from sim.demo.scenes import at_size, demo_scene, misalign
from tests.correction.fit.drawn_labs import drawn_lab
from tests.correction.fit.drawn_optics import Ball, Lab, shown_mm
from tests.correction.fit.strangers import stranger
from tests.slow_cases import slow
from tracer.scene.fit_section import FitTable

BEND_PER_MM = (0.003, -0.001, 0.002)  # z = (a x^2 + 2 b x y + c y^2) / 2: 1.5 mm, 30 mm from the middle
STEP = 1e-4
LARGER = 6.0  # all ways over all corners, than one way along half the view


@pytest.mark.parametrize("glass", [False, True])
def test_derivatives_by_the_scene_are_those_of_residuals_on_a_bent_board(glass):
    """Those of a flat board are wrong by all that a bend makes of a camera that moves."""
    scene = misalign(at_size(demo_scene("pair_off_axis"), 504), 3)
    unknowns = unknowns_of(scene, [0.0], FitTable())
    balls = tuple(Ball(s.centre_mm, s.radius_mm, s.medium.n(scene.wavelength_nm)) for s in scene.spheres)
    asked = np.linspace(60.0, 440.0, 20)
    pixels = np.stack(np.meshgrid(asked, asked), axis=-1).reshape(-1, 2)
    nodes, through = shown_mm(Lab(scene.camera, balls * glass, BEND_PER_MM), pixels)
    seen = np.isfinite(nodes[:, 0]) & ((through != 0) == glass)
    pixels, (x, y) = pixels[seen], nodes[seen].T
    corners = Corners(0, glass, pixels, nodes[seen], whitening(np.full(pixels.shape, 0.01)))
    ways = np.zeros((len(x), 6, 3))
    ways[:, 2] = np.stack((0.5 * x * x, x * y, 0.5 * y * y), axis=1)
    start, bend = np.zeros(len(unknowns.names)), np.array(BEND_PER_MM)
    here = on_moved_board(unknowns, start, bend, ways, corners)
    flat = on_moved_board(unknowns, start, 0.0 * bend, ways, corners)
    fits = np.linalg.norm(here.value, axis=1) < 0.05  # sigmas: not where a view turns over
    assert np.count_nonzero(fits) > 60
    assert np.median(np.linalg.norm(flat.value[fits], axis=1)) > 10.0
    for number, name in enumerate(unknowns.names):
        step = STEP * np.eye(len(start))[number]
        after, before = (on_moved_board(unknowns, at, bend, ways, corners).value for at in (step, -step))
        truly = (after - before) / (2.0 * STEP)
        known = fits & np.isfinite(truly).all(axis=1)
        changed = np.linalg.norm((truly - flat.rate[:, :, number])[known], axis=1)
        off = np.linalg.norm((truly - here.rate[:, :, number])[known], axis=1)
        negligible = 1e-6 * np.median(
            np.linalg.norm(truly[known], axis=1)
        )  # a turn moves pixels, near and far alike
        assert np.median(off) <= 0.1 * np.median(changed) + negligible, name
    for number in range(3):
        step = STEP * bend[number] * np.eye(3)[number]
        after, before = (on_moved_board(unknowns, start, bend + by, ways, corners).value for by in (step, -step))
        truly = (after - before) / (2.0 * step[number])
        said = here.rate[:, :, len(start) + number]
        off, size = (np.linalg.norm(one[fits], axis=1) for one in (said - truly, truly))
        assert np.median(off / size) < 1e-3


@pytest.mark.parametrize("seed", [71151, slow(71047), slow(71111)])
def test_a_bend_is_found_though_the_camera_went_aside_for_it(seed):
    """Sigma was a fourteenth of the error: the bend was found to be a fifth of what it is.

    Its size is that of one way along half the view, the sentence's of all ways over corners beyond it as well.  A
    camera 17 to 27 mm aside makes differences that derivatives of what is free say to a tenth or worse.
    """
    lab = drawn_lab(seed, "bent board", draw=stranger)
    said = re.search(r"the board is not flat: .* seems to bend by (\d+) um", lab.fit.verdict.sentences[0])
    assert said
    assert lab.size < 1e-3 * float(said[1]) < LARGER * lab.size
    _, error, sigma = lab.beside
    assert np.sqrt(np.mean(error**2)) > 0.05
    assert 0.8 < np.sqrt(np.mean((error / sigma) ** 2)) < 1.2
    known = lab.sigma_px.max(axis=1) < 2.0 * np.sqrt(np.mean(lab.error_px**2))
    chi = (lab.error_px / lab.sigma_px)[known]
    assert not len(chi) or 0.7 < np.sqrt(np.mean(chi**2)) < 1.3
