"""Light that falls while a shutter is open, and only then; pairs that were made beforehand."""

import json
from pathlib import Path

import numpy as np
import pytest

from ground.config import Document, validate
from ground.errors import ConfigError
from sim.flow.fields import Flow, Uniform
from sim.flow.images import FlowCamera
from sim.flow.table import FlowTable
from sim.light import LitFlow
from tests.sim.flow.test_view import flow_scene

MS = 1_000_000
DT_NS = 500_000


@pytest.fixture(scope="module")
def camera():
    return FlowCamera(flow_scene(size=160), Flow(Uniform((0.0, 400.0, 0.0))), seed=3)


def test_a_frame_shows_the_flash_that_fell_into_it(camera):
    lit = LitFlow()
    lit.flash(0, 100 * MS)
    lit.flash(1, 100 * MS + DT_NS)
    first, second = camera.pair(0, 1e-9 * DT_NS, 0.0)
    dark = lit.expose(camera, 90 * MS, 99 * MS)
    np.testing.assert_array_equal(lit.expose(camera, 99 * MS, 100 * MS + DT_NS), first)
    np.testing.assert_array_equal(lit.expose(camera, 100 * MS + DT_NS, 110 * MS), second)
    assert dark.max() < 60 < first.max()


def test_both_flashes_in_one_exposure_show_both(camera):
    lit = LitFlow()
    lit.flash(0, 100 * MS)
    lit.flash(1, 100 * MS + DT_NS)
    both = lit.expose(camera, 99 * MS, 110 * MS).astype(float)
    first, second = (frame.astype(float) for frame in camera.pair(0, 1e-9 * DT_NS, 0.0))
    assert (both - 35.0).sum() == pytest.approx((first - 35.0).sum() + (second - 35.0).sum(), rel=0.03)


def test_every_light_1_begins_a_pair_and_light_2_alone_shows_another(camera):
    lit = LitFlow()
    for k in range(3):
        lit.flash(0, (100 + 100 * k) * MS)
        if k != 1:
            lit.flash(1, (100 + 100 * k) * MS + DT_NS)
    lit.flash(1, 400 * MS)  # the first cavity did not fire
    third, _ = camera.pair(2, 1e-9 * DT_NS, 0.2)
    np.testing.assert_array_equal(lit.expose(camera, 299 * MS, 300 * MS + 1), third)
    lone = lit.expose(camera, 399 * MS, 401 * MS)
    assert not np.array_equal(lone, lit.expose(camera, 300 * MS + 1, 301 * MS))


def test_without_a_laser_light_falls_at_the_start_of_exposures(camera):
    lit = LitFlow()
    first, second = camera.pair(0, 1e-9 * DT_NS, 0.0)
    np.testing.assert_array_equal(lit.expose(camera, 7 * MS, 8 * MS), first)
    np.testing.assert_array_equal(lit.expose(camera, 7 * MS + DT_NS, 9 * MS), second)
    later = lit.expose(camera, 107 * MS, 108 * MS)
    np.testing.assert_array_equal(later, camera.pair(1, 0.0, 0.1)[0])


def test_before_the_seeding_is_open_only_reflections_are_seen(camera):
    lit = LitFlow()
    lit.seed(False)
    lit.flash(0, 100 * MS)
    lit.seed(True)  # before the picture of the first one is drawn
    lit.flash(0, 200 * MS)
    np.testing.assert_array_equal(
        lit.expose(camera, 99 * MS, 101 * MS), camera.pair(0, 0.0, 0.0, is_seeded=False)[0]
    )
    assert lit.expose(camera, 199 * MS, 201 * MS).mean() > 37.5


def flow_table(**values):
    return validate(Document(Path("bench.yaml"), values, {(): 1}), FlowTable)


def test_the_truth_of_a_flow_reads_back_as_the_same_flow():
    import yaml

    table = flow_table(field="vortex", parameters={"core_mm": 5.0}, turbulence={"length_mm": 3.0})
    again = flow_table(**yaml.safe_load(table.as_text(7)))
    assert again.flow(0) == table.flow(7)
    assert again.as_text(0) == table.as_text(7)
    assert json.dumps(yaml.safe_load(table.as_text(7)))


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"parameters": {"exit_m_s": 1.0}}, "exit_m_s is not known"),
        ({"parameters": {"exit_mm_s": "fast"}}, "valid number"),
        ({"sheet": {"thickness_mm": 0.0}}, "must be positive"),
        ({"seeding": {"per_px": -1.0}}, "per_px"),
        ({"field": "shear", "parameters": {"gradient_per_s": [[1, 0, 0], [0, 0, 0], [0, 0, 0]]}}, "diagonal"),
    ],
)
def test_a_wrong_flow_is_refused_with_its_place(values, text):
    with pytest.raises(ConfigError, match=text):
        flow_table(**values)
