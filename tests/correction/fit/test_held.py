"""Numbers that the fit section holds: the map's sigma counts them, and a wrong one is named."""

import numpy as np
import pytest

from correction.fit import adjustment
from correction.fit.judge.weakness import weaknesses
from correction.fit.seen import prediction
from correction.fit.solve import considered as doubts
from correction.fit.solve.considered import ORDINARY, ORDINARY_N, with_considered
from correction.fit.solve.unknowns import unknowns_of
from sim.demo.scenes import at_size, demo_scene
from tests.correction.fit.drawn_labs import drawn_lab
from tests.correction.fit.strangers import stranger
from tracer.scene.fit_section import FitNamedTable, FitTable

SCENE = at_size(demo_scene("two_spheres_500"), 700)


def test_what_is_free_or_has_a_sigma_is_not_doubted_again():
    assert (
        with_considered(unknowns_of(SCENE, [0.0], FitTable())).names == unknowns_of(SCENE, [0.0], FitTable()).names
    )
    measured = unknowns_of(SCENE, [0.0], FitTable(n=1e-6))
    assert with_considered(measured).names == measured.names


def test_what_is_held_is_doubted_by_its_ordinary_size_and_one_glass_has_one_index():
    held = unknowns_of(SCENE, [0.0], FitTable(n=0.0, named={"sphere1": FitNamedTable(centre_mm=0.0)}))
    wide = with_considered(held)
    glass = next(name for name in wide.names if name.startswith("glass "))
    assert wide.names[len(held.names) :] == ("sphere1.x", "sphere1.y", "sphere1.z", glass)
    np.testing.assert_allclose(wide.sigma[len(held.names) :], [*[ORDINARY["z"]] * 3, ORDINARY_N])
    moved = wide.full_names, np.flatnonzero(wide.columns[:, -1])
    assert [moved[0][at] for at in moved[1]] == ["sphere1.n", "sphere2.n"]


def test_the_sigma_of_the_map_holds_an_index_that_was_held_wrong_and_says_that_it_was_held(monkeypatch):
    def largest() -> float:
        lab = drawn_lab(20086, "index", size=1e-3)
        assert any("held, but how well known is not said" in weak.sentence for weak in weaknesses(lab.fit))
        return float(np.sqrt(np.mean((lab.error_px / lab.sigma_px) ** 2)))

    assert largest() < 1.5
    # What else is doubted would take the index over: pulled corners, and shapes.
    monkeypatch.setattr(prediction, "PULLED", 0.0)
    for module in (adjustment, doubts):
        monkeypatch.setattr(module, "shapes_to_consider", lambda unknowns: ())
    monkeypatch.setattr(adjustment, "with_considered", lambda unknowns: unknowns)
    assert largest() > 2.5


@pytest.mark.slow
def test_a_lab_known_along_one_way_and_not_at_all_along_another_is_judged_as_well():
    """Its covariance spans seventeen orders: the smallest eigenvalues are rounding, of either sign."""
    lab = drawn_lab(131009, "ball off")
    assert np.isfinite(lab.sigma_px).all()
    assert np.mean(np.abs(lab.error_px) < 2.0 * lab.sigma_px) > 0.8


def test_a_held_ball_that_shows_no_corner_is_as_unsure_as_one_that_is_free():
    """It stands 1.6 mm off, and nothing in the frames says so: its map must, behind it."""
    lab = drawn_lab(57009, "ball off", draw=stranger)
    assert lab.cost_px > 1.0
    assert not any(lab.ball in way for way in lab.fit.expected)
    assert np.mean(np.abs(lab.error_px) < 2.0 * lab.sigma_px) > 0.95
    said = [weak.sentence for weak in weaknesses(lab.fit) if "no corner is seen through" in weak.sentence]
    assert lab.ball in said[0].partition(":")[0]
