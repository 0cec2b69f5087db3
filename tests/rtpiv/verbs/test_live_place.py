"""`rtpiv bench live --simulate`: the simulated axes stand where the correction is for, and the page shows it."""

import re

import numpy as np

from daq.bench.bench_file import load_bench
from daq.live.live_page import LivePage
from rtpiv.verbs.live import live
from sim.bench import SimulatedBench
from tests.daq.runner.test_two_cameras import write_two
from tests.daq.small_bench import write_bench

SIDE_PX = 252
SIMULATION = "samples: 1\nis_misaligned: false\ncamera_transport: memory"


def likeness(one, other):
    """Correlation of two pictures in the middle, behind the balls, where both have light."""
    one, other = (picture[SIDE_PX // 4 : -SIDE_PX // 4, SIDE_PX // 4 : -SIDE_PX // 4] for picture in (one, other))
    both = np.isfinite(one) & np.isfinite(other)
    return np.corrcoef(one[both], other[both])[0, 1]


def test_the_page_of_a_simulated_bench_shows_its_board_as_without_glass(tmp_path, monkeypatch):
    """The axes were switched off beside the marks that they are homed at, the glass 65 mm below its place."""
    shown = []

    def keep(self, words, pictures):
        shown.append((words, {name: np.array(pixels) for name, pixels in pictures.items()}))

    monkeypatch.setattr(LivePage, "show", keep)
    path = write_bench(tmp_path, SIDE_PX, SIMULATION)
    live(path, simulate=True, for_s=0.2)
    words, pictures = shown[-1]
    assert words["view"] == "glass"
    assert words["rims"] is True

    bench = load_bench(path)
    simulation = SimulatedBench(bench)
    try:
        simulation.place(bench.home_mm | {"glass_y": -134.0})
        clear = simulation.world.light()
    finally:
        simulation.close()
    assert likeness(pictures["raw"], clear) < 0.7
    assert likeness(pictures["corrected"], clear) > 0.8  # squares of five pixels, blurred


def test_another_camera_of_the_bench_is_shown(tmp_path, monkeypatch):
    shapes = []
    monkeypatch.setattr(LivePage, "show", lambda self, words, pictures: shapes.append(pictures["raw"].shape))
    path, _ = write_two(tmp_path)
    free = re.sub(r"settings: {.*}", "settings: {AcquisitionFrameRate: 5.0, TriggerMode: 'Off'}", path.read_text())
    free = re.sub(r" +pairs: {shape.*\n", "", free)
    path.write_text(free.replace("samples: 1\n", "samples: 1\n  camera_transport: memory\n"))
    live(path, simulate=True, correct=False, for_s=0.1, camera="behind")
    height, width = shapes[-1]
    assert width == height - 16  # the first one's frames are square
