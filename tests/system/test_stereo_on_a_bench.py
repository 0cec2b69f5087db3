"""Two cameras of one simulated bench are joined to a field with three components, that of the flow."""

import numpy as np
import pytest
from scipy.io import netcdf_file

from rtpiv.command_line.cli import DONE, main
from tests.daq.cameras.rigs import need_harvesters
from tests.daq.runner.test_two_cameras import write_two
from tests.daq.small_bench import SCENE

SIDE_PX, PAIRS, DT_S = 320, 8, 100e-6  # the mean is filtered by its own scatter, which two pairs do not give
VELOCITY_MM_S = (9000.0, -4000.0, 2500.0)  # 1.8, -0.8, 0.5 px
FLOW = f"""samples: 1
  is_misaligned: false
  flow:
    field: uniform
    parameters: {{velocity_mm_s: {list(VELOCITY_MM_S)}}}
    turbulence: null
"""


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_w_of_two_cameras_is_that_of_the_flow(tmp_path):
    need_harvesters()
    bench, plan = write_two(tmp_path, pairs=PAIRS, chunk=PAIRS)
    scene = SCENE.format(side=SIDE_PX, pitch_um=11.0 * 2016 / SIDE_PX)
    (tmp_path / "scene.yaml").write_text(scene)
    place = f"position_mm: {[500.0 * np.sin(0.35).item(), 0.0, 500.0 * np.cos(0.35).item()]}, sensor_px"
    (tmp_path / "scene_behind.yaml").write_text(scene.replace("sensor_px", place))
    text = bench.read_text().replace("samples: 1\n", FLOW, 1)
    text = text.replace("timeout_s: 1.0", "timeout_s: 30.0").replace("max_rate_hz: 25.0", "max_rate_hz: 1.0")
    bench.write_text(text)
    plan.write_text(plan.read_text().replace("rate_hz: 25.0", "rate_hz: 1.0"))
    command = ["acquire", str(plan), "--bench", str(bench), "-o", str(tmp_path / "runs")]
    assert main([*command, "--simulate", "--home", "--operator", "test"]) == DONE
    (run,) = (tmp_path / "runs").glob("*_plan-flow")
    out = tmp_path / "joined"
    assert main(["mean", "--join", str(run), str(run / "cameras" / "behind"), "-o", str(out)]) == DONE
    with netcdf_file(out / "mean.nc", mmap=False) as file:
        found = {name: np.array(file.variables[name][0]) for name in ("u", "v", "w", "sigma_w")}
        px_per_m_s = 1e3 * DT_S * file.px_per_mm
    assert np.isfinite(found["w"]).mean() > 0.5
    for name, true in zip("uvw", VELOCITY_MM_S, strict=True):
        off_px = (found[name] - 1e-3 * true) * px_per_m_s
        assert np.nanmedian(np.abs(off_px)) < 0.05  # w by 0.07 where each camera sees particles of its own
