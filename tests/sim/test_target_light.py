"""A simulated target is seen in the light that the scene file tells of it, particles in that of the laser."""

from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from daq.bench.bench_file import load_bench
from sim.bench_table import simulation_of
from sim.light import COLOURS, colours_of
from sim.world import World
from tests.daq.small_bench import write_bench
from tracer.light import band, light_of, line, white_led
from tracer.scene.scene_file import load_priors, load_scene


def world(folder, shows, *, scene_nm=532.0, light=None):
    """A small bench's world with two balls of N-BK7, and everything at home."""
    path = write_bench(folder, 64, "samples: 1\nis_misaligned: false")
    tree = yaml.safe_load((folder / "scene.yaml").read_text())
    for body in tree["bodies"]:
        body["material"] = "N-BK7"
    tree |= {"wavelength_nm": scene_nm} | ({} if light is None else {"fit": {"light": light}})
    (folder / "scene.yaml").write_text(yaml.safe_dump(tree))
    bench = load_bench(path)
    stages = SimpleNamespace(true_mm=bench.home_mm.__getitem__, is_moving=False)
    return World(bench, simulation_of(bench), stages, shows, 0)


def test_a_board_lit_by_an_led_is_drawn_in_its_light(tmp_path):
    red = world(tmp_path / "led", "chessboard", light={"mean_nm": 625.0})
    as_red, as_green = (world(tmp_path / f"{nm}", "chessboard", scene_nm=nm) for nm in (625.0, 532.0))
    frame = red.frame(0, 0)
    assert np.array_equal(frame, as_red.frame(0, 0))
    assert not np.array_equal(frame, as_green.frame(0, 0))


def test_particles_are_drawn_in_the_lasers_light(tmp_path):
    told = world(tmp_path / "led", "particles", light={"mean_nm": 625.0})
    assert np.array_equal(told.frame(0, 0), world(tmp_path / "none", "particles").frame(0, 0))
    assert "fit" not in yaml.safe_load(told.truth())


def test_a_wide_light_is_the_sum_of_its_colours(tmp_path):
    lines = {"lines": [[450.0, 1.0], [650.0, 3.0]]}
    sides = [world(tmp_path / f"{nm}", "chessboard", light={"mean_nm": nm}).light() for nm in (450.0, 650.0)]
    both = world(tmp_path / "both", "chessboard", light=lines).light()
    assert both == pytest.approx(0.25 * sides[0] + 0.75 * sides[1], abs=1e-5)


def test_the_truth_says_which_light(tmp_path):
    led = {"mean_nm": 625.0, "width_nm": 20.0}
    told = world(tmp_path / "led", "chessboard", light=led)
    (tmp_path / "truth.yaml").write_text(told.truth())
    assert load_priors(tmp_path / "truth.yaml").light.model_dump(exclude_none=True, exclude_defaults=True) == led
    assert load_scene(tmp_path / "truth.yaml").content_hash() == told.scene.content_hash()


@pytest.mark.parametrize("light", [white_led(4000.0), band(450.0, 650.0)], ids=["white", "band"])
def test_a_few_colours_have_the_moments_of_the_spectrum(light):
    lengths, shares = np.array(colours_of(light)).T
    assert len(lengths) == COLOURS
    assert shares.min() > 0.0
    for order in range(2 * COLOURS):
        spectrum = np.dot(((np.array(light.wavelength_nm) - 550.0) / 100.0) ** order, light.weight)
        assert np.dot(((lengths - 550.0) / 100.0) ** order, shares) == pytest.approx(spectrum, rel=1e-9, abs=1e-9)


def test_few_lines_are_drawn_as_they_are():
    assert colours_of(line(532.0)) == ((532.0, 1.0),)
    assert colours_of(light_of([450.0, 550.0, 650.0], [1.0, 0.0, 3.0])) == ((450.0, 0.25), (650.0, 0.75))
