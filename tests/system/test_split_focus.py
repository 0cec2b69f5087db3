"""Split focus in one run: two cameras, one sharp on the plane and one on its image behind the glass, one mean."""

import numpy as np
import pytest
from scipy.io import netcdf_file

from rtpiv.command_line.cli import DONE, main
from tests.daq.cameras.rigs import need_harvesters
from tests.daq.runner.test_two_cameras import write_two
from tests.daq.small_bench import SCENE

LENS = "aperture: {{f_mm: 60.0, f_number: 4.0, focus_mm: {focus_mm}}}"
PAIRS = 6


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_one_run_of_two_cameras_becomes_one_mean(tmp_path, capsys):
    need_harvesters()
    bench, plan = write_two(tmp_path, pairs=PAIRS, chunk=3, further=f", {LENS.format(focus_mm=420.0)}")
    for name in ("scene.yaml", "scene_behind.yaml"):
        (tmp_path / name).write_text(SCENE.format(side=96, pitch_um=11.0 * 2016 / 96))
    text = bench.read_text().replace("samples: 1\n", f"samples: 1\n  {LENS.format(focus_mm=500.0)}\n", 1)
    text = text.replace("timeout_s: 1.0", "timeout_s: 30.0").replace("max_rate_hz: 25.0", "max_rate_hz: 1.0")
    bench.write_text(text)
    plan.write_text(plan.read_text().replace("rate_hz: 25.0", "rate_hz: 1.0"))
    command = ["acquire", str(plan), "--bench", str(bench), "-o", str(tmp_path / "runs")]
    assert main([*command, "--simulate", "--home", "--operator", "test"]) == DONE
    (run,) = (tmp_path / "runs").glob("*_plan-flow")
    beside = run / "cameras" / "behind"
    for folder in (run, beside):
        windows = ("--first-window", "32", "--final-window", "16", "--workers", "1")
        assert main(["mean", str(folder), *windows]) == DONE
    capsys.readouterr()
    out = tmp_path / "joined"
    assert main(["mean", "--join", str(run / "series"), str(beside / "series"), "-o", str(out)]) == DONE
    apart = float(capsys.readouterr().out.split("differ by ")[1].split()[0])
    assert apart < 2.0  # they saw the same light on the same particles
    with netcdf_file(out / "mean.nc", mmap=False) as file:
        source = np.array(file.variables["source"][0])
    assert {1, 2} <= set(np.unique(source))
    assert main(["check", str(run)]) == DONE
