"""A flow becomes steps with pulses; what laser, camera and marker cannot do is one sentence."""

import pytest

from daq.bench.bench_file import load_bench
from daq.bench.guards import idle_stage
from daq.errors import DaqError
from daq.plans.forecast import forecast
from daq.plans.plan import load_plan
from ground.errors import ConfigError
from tests.daq.small_bench import write_bench
from tests.loops import loop_over

LASER = (
    "  laser: {kind: timing, box: qc9520, port: /dev/one, channels: {q_switch_1: B, q_switch_2: D, camera: E, "
    "marker: F}, head: {max_rate_hz: 15.0}}\n"
)
PAIRS = (
    "{shape: two_blocks, marker: line_status, line: 2, dead_us: 2.0, second_exposure_us: 20000.0, most_hz: 12.0}"
)
SETTINGS = "settings: {ExposureTime: 200.0, TriggerMode: 'On', TriggerSource: Line1}"
PLAN = "experiment: flow\nview: glass\nlaser: laser\npairs: 40\ndt_us: 80.0\nrate_hz: 10.0\n"


def flow(folder, plan=PLAN, pairs=PAIRS, settings=SETTINGS, laser=LASER):
    """The bench and the loaded plan."""
    path = write_bench(folder)
    lines = path.read_text().splitlines(keepends=True)
    kept = [line for line in lines if not line.lstrip().startswith(("settings:", "TriggerSource", "camera:"))]
    camera = f"camera: {{backend: harvesters, options: {{cti: x.cti}}, {settings}, pairs: {pairs}}}\n"
    path.write_text("".join(_without_camera(lines)) + camera + "devices:\n" + laser)
    assert kept
    bench = load_bench(path)
    plan_path = folder / "plan-flow.yaml"
    plan_path.write_text(plan)
    return bench, load_plan(plan_path, bench)


def _without_camera(lines):
    """The file less its section `camera`."""
    inside = False
    for line in lines:
        if not line.startswith((" ", "#")):
            inside = line.startswith("camera:")
        if not inside:
            yield line


def test_background_and_flow_are_steps_of_their_own(tmp_path):
    bench, plan = flow(
        tmp_path, PLAN + "background: {pairs: 5}\nchunk: 20\ndt_measured_us: 80.2\ndt_sigma_us: 0.1\n"
    )
    before, after = plan.steps
    assert (before.tag, before.first_frame, before.frames, before.group) == ("background_glass", 0, 10, 2)
    assert (after.tag, after.first_frame, after.frames, after.on_plane) == ("flow_glass", 10, 80, True)
    assert before.pulses.is_background
    assert not after.pulses.is_background
    assert (after.pulses.chunk, after.pulses.dt_measured_us, after.pulses.dt_sigma_us) == (20, 80.2, 0.1)
    assert after.may_have_gaps
    said = forecast(bench, idle_stage(bench), plan.steps)
    assert said.frames == 90
    assert said.duration_s > 4.5
    width, height = bench.scene.camera.sensor_px
    assert said.raw_bytes >= 90 * 2 * width * height


def test_a_chunk_is_ten_seconds_if_nothing_is_said(tmp_path):
    _, plan = flow(tmp_path, PLAN.replace("pairs: 40", "pairs: 400"))
    assert plan.steps[0].pulses.chunk == 100


def test_another_dt_is_another_plan(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    one = flow(tmp_path / "a")[1].content_hash()
    other = flow(tmp_path / "b", PLAN.replace("80.0", "81.0"))[1].content_hash()
    assert one != other


@loop_over("changes, words", [
    ({"plan": PLAN.replace("dt_us: 80.0\n", "")}, "dt_us"),
    ({"plan": PLAN.replace("80.0", "-1.0")}, "dt_us: should be greater than 0"),
    ({"plan": PLAN.replace("80.0", ".nan")}, "not a finite number"),
    ({"plan": PLAN.replace("80.0", "30000.0")}, "dt of 30000 us does not fit into the two exposures"),
    ({"plan": PLAN.replace("80.0", "200000.0")}, "longer than the 100000 us from pair to pair"),
    ({"plan": PLAN.replace("80.0", "3.0")}, "dt of 3 us does not fit into the two exposures"),
    ({"plan": PLAN.replace("rate_hz: 10.0", "rate_hz: 13.0")}, "13 pairs/s are more than the camera's 12"),
    ({"plan": PLAN.replace("rate_hz: 10.0", "rate_hz: 20.0")}, "20 pairs/s are more than the laser's 15"),
    ({"plan": PLAN + "chunk: 101\n"}, "1 to 100 fit into the 10 s"),
    ({"plan": PLAN + "frames: 3\n"}, "set pairs instead of frames"),
    ({"plan": PLAN + "dt_sigma_us: 0.1\n"}, "belongs to a dt_measured_us"),
    ({"plan": PLAN.replace("laser: laser", "laser: lamp")}, "no timing unit 'lamp'; there are laser"),
    ({"plan": PLAN + "operator: me\n"}, "unknown key"),
    ({"settings": SETTINGS.replace("ExposureTime: 200.0, ", "")}, "lacks ExposureTime"),
    ({"settings": SETTINGS.replace("Line1", "Software")}, "triggered by the timing unit"),
    ({"pairs": "{shape: two_blocks, dead_us: 2.0}"}, "A and B need a marker"),
    ({"pairs": "null"}, "which distinguishes exposure A from exposure B"),
    ({"pairs": "{shape: straddling, marker: line_status, line: 2, dead_us: 2.0, second_exposure_us: 100.0}"},
     "have one exposure"),
    ({"pairs": "{shape: straddling, marker: line_status, line: 2, dead_us: 2.0}"}, "wire channel camera_b"),
    ({"laser": LASER.replace("marker: F", "marker: F, camera_b: G")}, "camera_b would trigger unwanted exposures"),
    ({"pairs": "{shape: burst, marker: spacing, dead_us: 49800.0}",
      "plan": PLAN.replace("80.0", "49900.0")}, "does not mark A"),
])  # fmt: skip
def test_what_cannot_be_done_is_one_sentence(tmp_path, changes, words):
    with pytest.raises((ConfigError, DaqError), match=words) as caught:
        flow(tmp_path, **changes)
    assert "\n" not in str(caught.value).strip()


@pytest.mark.parametrize(
    ("places", "said"),
    [
        ("target_z_mm: -30.0\n", "glass 0 mm from the light sheet, and 4 mm must be free"),
        ("glass_z_mm: 8.0\ntarget_z_mm: -3.0\n", "target 3 mm from the light sheet, and 4 mm"),
        ("", "glass 0 mm and target 0 mm from the light sheet, and 4 mm"),
    ],
)
def test_what_stands_in_the_light_sheet_is_named_and_nothing_else(tmp_path, places, said):
    bench, plan = flow(tmp_path, PLAN + places)
    texts = [found.text for found in forecast(bench, idle_stage(bench), plan.steps).violations]
    (text,) = [text for text in texts if "light sheet" in text]
    assert said in text
    for name in ("glass", "target"):
        assert (f"{name}_z_mm" in text) == (f"{name} " in said)
