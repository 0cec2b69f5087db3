"""The height of a sheet between balls by its brightness, in frames of the simulator's own optics."""

from dataclasses import replace

import numpy as np
import pytest

from correction.light_sheet.by_brightness import _brightness, height_by_brightness
from sim.flow.fields import Flow, Uniform
from sim.flow.images import FlowCamera
from sim.flow.particles import LightSheet, Seeding
from tests.tracer.scenes import ball, camera_at
from tracer.light_sheet import LightSheet as PlaneOfLight
from tracer.light_sheet import SheetSource
from tracer.scene.scene import Scene

# The sheet leaves the first ball well off its middle, and the second one gets it bent.
BALLS = (ball("a", -24.0, 4.0, 26.0, 12.0), ball("b", 8.0, -2.0, 18.0, 14.0), ball("c", 4.0, 26.0, 24.0, 10.0))
SHEET = PlaneOfLight(22.0, thickness_mm=1.0, sources=(SheetSource(180.0, 120.0),))
SCENE = Scene(camera_at((0.0, 0.0, 400.0), focal_px=600.0, sensor_px=(120, 120)), BALLS, sheet=SHEET)


def given_at(z_mm: float) -> Scene:
    return replace(SCENE, sheet=replace(SHEET, z_mm=z_mm))


@pytest.mark.slow
def test_a_frame_of_the_traced_light_tells_the_height_it_was_traced_at():
    """An uneven gain, and the scatter of a thousand particles a pixel; the scene says 0.8 mm less."""
    bright = np.nan_to_num(_brightness(given_at(22.0).in_light_sheet())[0])
    gain = np.linspace(0.7, 1.4, bright.shape[1])
    mean = np.random.default_rng(1).poisson(1000.0 * gain * bright) / 25.0
    found = height_by_brightness(given_at(21.2), mean)
    assert found is not None
    assert found.z_mm == pytest.approx(22.0, abs=0.05)
    assert found.is_elsewhere
    assert "correct sheet.z_mm" in found.sentence
    assert height_by_brightness(replace(SCENE, sheet=replace(SHEET, sources=())), mean) is None


@pytest.mark.slow
def test_frames_of_the_simulators_own_optics_tell_the_height_within_its_uncertainty():
    """Eight exposures, each with many particles; a sheet 0.8 mm off is found, one in its place is left there."""
    camera = FlowCamera(
        SCENE, Flow(Uniform()), LightSheet(offset_mm=22.0), Seeding(per_px=0.6), reflections=None, seed=5
    )
    mean = np.mean([camera.pair(number, 1e-4, 0.0)[0] for number in range(8)], axis=0) - 35.0
    for given in (22.0, 21.2):
        found = height_by_brightness(given_at(given), mean)
        assert found is not None
        assert abs(found.z_mm - 22.0) < 2.0 * found.sigma_mm
        assert found.sigma_mm < 0.45
        assert found.is_elsewhere == (given != 22.0)
