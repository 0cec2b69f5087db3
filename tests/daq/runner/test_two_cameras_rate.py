"""Two cameras at 10 pairs/s for a minute, 1008 x 1008 px each: no pair lost, and every one by its trigger."""

import os
import time

import pytest
import tifffile

from daq.runs.pairs import pairs_of
from daq.runs.run_check import check_run
from daq.runs.run_folder import RunFolder
from sim import world
from tests.daq.cameras.rigs import need_aravis, need_harvesters
from tests.daq.flow_bench import ToldLight, acquire_simulated, told
from tests.daq.runner.test_two_cameras import write_two
from tests.daq.small_bench import SCENE

SIDE, PAIRS, RATE_HZ = 1008, int(os.environ.get("PAIRS", "600")), 10.0


def link_losses(folder):
    """Frames that did not come whole over the loopback: its socket is small, and the machine may be busy."""
    books = [entry["books"] for entry in RunFolder.open(folder).entries() if entry["kind"] == "counts"]
    return sum(each["incomplete"] + each["missing"] for each in books)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("backend", ["harvesters", "aravis"])
def test_a_minute_of_pairs_from_both(tmp_path, monkeypatch, backend):
    need_harvesters()
    if backend == "aravis":
        need_aravis()
    monkeypatch.setattr(world, "LitFlow", ToldLight)
    bench, plan = write_two(tmp_path, backend=backend, pairs=PAIRS, chunk=100)
    for name in ("scene.yaml", "scene_behind.yaml"):
        (tmp_path / name).write_text(SCENE.format(side=SIDE, pitch_um=11.0 * 2016 / SIDE))
    text = bench.read_text().replace("second_exposure_us: 192.0", f"second_exposure_us: {2.0 * SIDE}")
    bench.write_text(text.replace("max_rate_hz: 25.0", f"max_rate_hz: {RATE_HZ}"))
    plan.write_text(plan.read_text().replace("rate_hz: 25.0", f"rate_hz: {RATE_HZ}"))
    begun_s = time.monotonic()
    path = acquire_simulated(plan, bench, tmp_path / "runs")
    took_s = time.monotonic() - begun_s
    beside = path / "cameras" / "behind"
    for folder in (path, beside):
        assert check_run(folder).is_sound
        chunks = [entry for entry in RunFolder.open(folder).entries() if entry["kind"] == "chunk"]
        fired, kept, surplus, lost = (sum(c[key] for c in chunks) for key in ("fired", "pairs", "surplus", "lost"))
        times = [pair.time_s for pair in pairs_of(folder).pairs]
        print(f"{folder.name}: {fired} fired, {kept} kept, {surplus} surplus, {lost} lost; {took_s:.0f} s in all")
        assert kept == PAIRS
        assert lost == 0 or (backend == "aravis" and lost <= link_losses(beside))
        assert (len(times) - 1) / (times[-1] - times[0]) < 1.05 * RATE_HZ
    for number in range(0, 2 * PAIRS):
        one, other = (tifffile.imread(each / "frames" / f"{number:06d}.tif") for each in (path, beside))
        assert one.shape == other.shape == (SIDE, SIDE)
        assert told(one) == told(other)
        assert told(one)[2] == number % 2
