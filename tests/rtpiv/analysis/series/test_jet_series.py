"""A jet that is known, behind two balls and with reflections of the sheet in them: frames of a run to its mean."""

import numpy as np
import pytest

from daq.runs.journal import Journal
from daq.runs.run_folder import RunFolder
from rtpiv.verbs.mean import mean
from sim.demo.scenes import at_size, demo_scene
from sim.flow.fields import Flow
from sim.flow.images import FlowCamera
from sim.flow.jet import Jet
from sim.flow.modes import RandomModes
from sim.flow.particles import LightSheet
from tests.daq.small_run import about_run, keep_frame, planned
from tests.sim.flow.windows_of_flow import window_mean, window_places
from tracer.bodies import translate_by
from tracer.scene.scene_file import dump_scene

PAIRS, SIDE_PX, DT_S, RATE_HZ, WINDOW_PX = 24, 504, 2e-3, 10.0, 32
RADIUS_MM, GAP_MM = 25.0, 4.0


def flow_run(parent, scene, flow):
    """A flow run whose frames show what `flow` does."""
    camera = FlowCamera(scene, flow, seed=14)
    step = planned(0, "flow", frames=2 * PAIRS, first_frame=0) | {"group": 2, "dt_us": DT_S * 1e6}
    folder = RunFolder.create(parent, "flow", about_run([step]) | {"scene": dump_scene(scene)})
    journal = Journal(folder.journal_path)
    for pair in range(PAIRS):
        for pulse, pixels in enumerate(camera.pair(pair, DT_S, pair / RATE_HZ)):
            number, stamp = 2 * pair + pulse, 10**9 + round(1e9 * (pair / RATE_HZ + DT_S * pulse))
            record = {"exposure": "AB"[pulse], "chunk": 0, "dt_us": DT_S * 1e6, "marker": "halves"}
            keep_frame(folder, journal, number, pixels, step=0, tag="flow", sequence=number, timestamp_ns=stamp,
                       received_ns=stamp + 1, pair=record)  # fmt: skip
    journal.close()
    return folder.path


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_mean_of_a_jet_is_as_sure_as_it_says_where_the_background_is_taken_off(tmp_path):
    """Errors behind the glass are within their sigma as often as they should be; with reflections, less often."""
    stack = at_size(demo_scene("two_spheres_500"), SIDE_PX)
    scene = stack.with_bodies([body.moved(translate_by((0.0, 0.0, GAP_MM))) for body in stack.bodies])
    flow = Flow(Jet(), RandomModes(8.0, seed=14))
    run = flow_run(tmp_path, scene, flow)
    error, covered = {}, {}
    for name, steps in (("none", ()), ("sliding", ("sliding-minimum",))):
        found = mean(run, tmp_path / name, final_window_px=WINDOW_PX, prepare=steps)
        x, y = np.meshgrid(found.x_mm, found.y_mm)
        window_mm = WINDOW_PX / found.px_per_mm
        places, weights = window_places(window_mm, LightSheet(), 0.3 * window_mm / np.sqrt(2.0))
        points = np.column_stack((x.ravel(), y.ravel(), np.zeros(x.size)))
        true = 1e-3 * window_mean(flow, points, places, weights)[:, :2].reshape(*x.shape, 2)
        behind = (np.hypot(x, y) < RADIUS_MM) & (found.count > 0.5 * found.used)
        assert behind.sum() > 50
        off, sigma = ((values * found.px_per_m_s)[behind] for values in (found.mean_m_s - true, found.sigma_m_s))
        error[name] = float(np.sqrt(np.mean(off**2)))
        covered[name] = float(np.mean(np.abs(off) < sigma))
    print(error, covered)
    assert error["sliding"] < 0.95 * error["none"]  # coarse light goes off unasked
    assert covered["none"] < covered["sliding"]
    assert 0.5 < covered["sliding"] < 0.8
