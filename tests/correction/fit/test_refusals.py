"""Frames that cannot determine the scene: one sentence with the cure, never a wrong scene."""

from dataclasses import replace

import numpy as np
import pytest

from correction.errors import FitFailed, GlassNotSeen, TargetNotFound, ViewsMissing
from correction.fit.scene_fit import fit_scene
from correction.fit.seen.measurement import TargetFrame
from correction.target import Chessboard
from tests.correction.fit.benches import SIZE_PX as FULL_PX
from tests.correction.fit.benches import SQUARE_MM as FULL_SQUARE_MM
from tests.correction.fit.benches import bench, photograph
from tests.correction.fit.rendered_labs import photographed
from tracer.media import ConstantMedium

SIZE_PX = 714
MADE = ("two_spheres_500", 6, (), (), SIZE_PX)
SQUARE_MM = FULL_SQUARE_MM * FULL_PX / SIZE_PX
BOARD = Chessboard(SQUARE_MM, 0.4 * SQUARE_MM)


def clear_and_glass():
    frames = bench(*MADE).frames
    return next(f for f in frames if not f.glass), next(f for f in frames if f.glass)


def flat(glass: bool, level: int = 1500) -> TargetFrame:
    noise = np.random.default_rng(0).normal(0.0, 8.0, (SIZE_PX, SIZE_PX))
    return TargetFrame("flat", (level + noise).astype(np.uint16), glass)


def test_no_bare_target():
    with pytest.raises(ViewsMissing, match="bare target at z = 0 is needed"):
        fit_scene(bench(*MADE).nominal, clear_and_glass()[1:], BOARD)


def test_no_glass_frame():
    with pytest.raises(ViewsMissing, match="no frame shows the target through them"):
        fit_scene(bench(*MADE).nominal, clear_and_glass()[:1], BOARD)


def test_no_corners():
    with pytest.raises(TargetNotFound, match="flat: no chessboard in the frame"):
        fit_scene(bench(*MADE).nominal, [flat(False), clear_and_glass()[1]], BOARD)


@pytest.mark.slow
def test_no_corners_behind_glass():
    with pytest.raises(GlassNotSeen, match="flat: only 0 corners where the glass should be"):
        fit_scene(bench(*MADE).nominal, [clear_and_glass()[0], flat(True)], BOARD)


@pytest.mark.slow
def test_squares_too_small_through_the_glass():
    """A small ball far from the target shows all of it, far too small."""
    nominal = bench(*MADE).nominal
    scene = nominal.with_bodies([replace(nominal.spheres[0], centre_mm=(10.0, 5.0, 150.0), radius_mm=16.0)])
    frames = [
        photograph(scene if glass else scene.with_bodies(()), glass, 0.0, 1, SQUARE_MM) for glass in (False, True)
    ]
    with pytest.raises(GlassNotSeen, match=r"squares look \d\.\d px wide through the glass, 10 are needed; print"):
        fit_scene(scene, frames, BOARD)


def test_wrong_board():
    with pytest.raises(TargetNotFound, match=r"target_clear.*those of the board described"):
        fit_scene(bench(*MADE).nominal, clear_and_glass(), Chessboard(SQUARE_MM, 0.2 * SQUARE_MM))


def test_spheres_missing_in_the_frame():
    clear = clear_and_glass()[0]
    with pytest.raises(GlassNotSeen, match="lie on the bare lattice"):
        fit_scene(bench(*MADE).nominal, [clear, replace(clear, glass=True, name="glass")], BOARD)


@pytest.mark.slow
def test_wrong_glass_is_never_silent():
    """A scene whose balls have another size and index than those photographed."""
    nominal = bench(*MADE).nominal
    other = [
        replace(body, radius_mm=20.0, medium=ConstantMedium(1.7), centre_mm=(0.0, 0.0, 20.0 + 41.0 * number))
        for number, body in enumerate(nominal.bodies)
    ]
    with pytest.raises(FitFailed, match="the fit failed at gate") as caught:
        fit_scene(nominal.with_bodies(other), clear_and_glass(), BOARD)
    assert caught.value.gate
    assert caught.value.value != caught.value.limit


@pytest.mark.slow
def test_another_square_than_believed_is_noticed_by_the_distance():
    truth = bench(*MADE).truth
    clear = photograph(truth.with_bodies(()), False, 0.0, 1, square_mm=1.1 * SQUARE_MM)
    with pytest.raises(FitFailed, match=r"1\.1 times as large as .* give the right square_mm \(about 5\.4\d\)"):
        fit_scene(bench(*MADE).nominal.with_bodies(()), [clear], BOARD)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("seed", "why"),
    [(71014, "shows no corner of the board whole behind glass"), (71044, r"squares look 3\.\d px wide through")],
)
def test_a_strangers_lab_whose_squares_do_not_suit_its_glass_is_told_so(seed, why):
    """Squares so wide that no ball shows a whole one, and so narrow that noise pairs them wherever balls stand."""
    lab = photographed("stranger", seed)
    with pytest.raises(GlassNotSeen, match=why):
        fit_scene(lab.nominal, lab.frames, lab.board, lab.priors)
