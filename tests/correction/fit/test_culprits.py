"""Of all that may be wrong, what explains the frames is named, and not an innocent number that took it up."""

from dataclasses import replace

import numpy as np
import pytest

from correction.fit.adjustment import Adjustment
from correction.fit.errors import FitFailed
from correction.fit.result import check
from correction.fit.unknowns import unknowns_of
from sim.demo.scenes import at_size, misaligned, named_scene
from tests.correction.fit.drawn_labs import BOARD, photographed
from tests.correction.fit.drawn_optics import Ball, Lab
from tracer.fit_section import FitTable
from tracer.media import ConstantMedium


def test_a_flint_ball_whose_index_is_held_wrong_is_named_and_not_the_radius_that_took_it_up():
    rng = np.random.default_rng((35, 1))
    named = at_size(named_scene("two_spheres_500"), 1008)
    true, told = (
        named.with_bodies([replace(b, medium=ConstantMedium(n)) for b, n in zip(named.spheres, each, strict=True)])
        for each in ((1.62, 1.515), (1.63, 1.515))
    )
    truth = misaligned(true, 501)
    balls = tuple(Ball(s.centre_mm, s.radius_mm, s.medium.n(truth.wavelength_nm)) for s in truth.spheres)
    frames = []
    for glass in (False, True):
        scene = truth if glass else truth.with_bodies(())
        frames.append(photographed(scene, Lab(truth.camera, balls * glass), BOARD, glass, 0.006, 0.01, rng))
    bench = unknowns_of(told, [0.0], FitTable(n=0.0))
    fit = Adjustment().estimate(bench, bench.start, frames, ())
    assert np.abs(fit.x).max() > 5.0  # the radius of an innocent ball
    assert fit.verdict.cause.ball == "sphere1"
    words = "sphere1.n was held at 1.63 and seems to be off by -0.0099"
    assert words in fit.verdict.cause.sentence
    with pytest.raises(FitFailed, match=words):
        check(fit)
