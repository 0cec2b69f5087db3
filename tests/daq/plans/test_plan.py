"""Plans as data: expansion, routes, forecast, and what is refused before anything moves."""

import math
from dataclasses import asdict, replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.bench.bench_file import load_bench
from daq.bench.bench_table import digest
from daq.bench.guards import idle_stage
from daq.errors import PlanError
from daq.plans.forecast import forecast
from daq.plans.plan import load_plan
from daq.plans.steps import Step, frame_count, route, steps_hash
from ground.errors import ConfigError
from tests.daq.small_bench import SHIFT, TARGET, load, write_bench

ONE_SHIFT = "experiment: shift\nviews: [glass]\ndisplacements: [{}]\n"


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    return load_bench(write_bench(tmp_path_factory.mktemp("bench")))


def steps_of(bench, text):
    path = bench.path.parent / "p.yaml"
    path.write_text(text)
    return load_plan(path, bench).steps


def test_target_run_moves_the_glass_out_once_and_in_once(bench):
    steps = steps_of(bench, TARGET)
    assert [step.tag for step in steps] == ["target_clear", "target_clear_z-10mm", "target_glass"]
    assert [step.targets_mm["glass_y"] for step in steps] == [-130.0, -130.0, 0.0]
    assert [step.targets_mm["target_z"] for step in steps] == [0.0, -10.0, 0.0]
    assert [step.on_plane for step in steps] == [True, False, True]
    assert all(set(step.targets_mm) == set(bench.home_mm) for step in steps)


def test_shift_has_a_reference_right_before_each_displacement(bench):
    steps = steps_of(bench, SHIFT + "repeats: 2\nframes: 3\n")
    assert len(steps) == 2 * 2 * 2 * 2
    assert frame_count(steps) == 3 * len(steps)
    assert [number for step in steps for number in step.numbers] == list(range(48))
    for step in steps:
        if step.reference is None:
            assert step.targets_mm["target_x"] == step.targets_mm["target_y"] == 0.0
        else:
            assert step.reference == step.index - 1


def test_displacement_in_px_is_that_of_the_bare_view(bench):
    """14 px of 11 um at magnification f/(L - f) = 60/440, along a diagonal."""
    step = steps_of(bench, ONE_SHIFT.format("{along: [1.0, 1.0, 0.0], px: 2.0}"))[1]
    pitch_mm = 11e-3 * 2016 / 96
    length = 2.0 * pitch_mm / (60.0 / 440.0)
    assert step.targets_mm["target_x"] == pytest.approx(length / math.sqrt(2.0), rel=1e-12)
    assert step.targets_mm["target_y"] == pytest.approx(length / math.sqrt(2.0), rel=1e-12)
    assert step.targets_mm["target_z"] == 0.0


def test_expansion_is_a_value(bench):
    assert steps_of(bench, SHIFT) == steps_of(bench, SHIFT)
    assert hash(steps_of(bench, SHIFT)[0]) == hash(steps_of(bench, SHIFT)[0])
    one, other = (load(bench.path.parent / name, SHIFT)[1] for name in ("one", "other"))
    assert one.content_hash() == other.content_hash()
    changed = load(bench.path.parent / "third", SHIFT.replace("mm: 0.5", "mm: 0.51"))[1]
    assert changed.content_hash() != one.content_hash()


def test_bench_hash_ignores_ports_and_nothing_else(tmp_path):
    path = write_bench(tmp_path)
    before, text = load_bench(path).content_hash(), path.read_text()
    path.write_text(text.replace("/dev/ttyUSB0", "/dev/ttyUSB7"))
    assert load_bench(path).content_hash() == before
    path.write_text(text.replace("steps_per_mm: 320.0", "steps_per_mm: 321.0"))
    assert load_bench(path).content_hash() != before


@pytest.mark.parametrize(
    ("plan", "words"),
    [
        ("experiment: nonsense\n", "should be one of target, shift, stream"),
        ("experiment: target\n", "at least one of clear and glass"),
        ("experiment: target\nclear: {z_mm: [0.0]}\nframs: 2\n", "did you mean 'frames'"),
        (ONE_SHIFT.format("{along: [0.0, 0.0, 0.0], mm: 1.0}"), "not be zero"),
        (ONE_SHIFT.format("{along: [1.0, 0.0, 0.0]}"), "exactly one of mm and px"),
        (ONE_SHIFT.format("{along: [1.0, 0.0, 0.0], mm: 1.0}").replace("[glass]", "[glass, glass]"), "twice"),
        ("experiment: target\nclear: {z_mm: [.nan]}\n", "not a finite number"),
    ],
)
def test_mistakes_in_a_plan_name_file_and_cure(bench, plan, words):
    with pytest.raises(ConfigError, match=r"p\.yaml:?\d*: ") as caught:
        steps_of(bench, plan)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("glass_y: -130.0", "glas_y: -130.0"), "unknown axis 'glas_y'"),
        (("glass_y: -130.0", "rail_z: -130.0"), "does not carry the glass"),
        (("carries: target, along: x", "carries: flow, along: x"), "known are camera, glass, target"),
        (("timeout_s: 60.0", "timeout_s: 0.0"), "greater than 0"),
    ],
)
def test_mistakes_in_a_bench_name_the_line(tmp_path, change, words):
    path = write_bench(tmp_path)
    path.write_text(path.read_text().replace(*change))
    with pytest.raises(ConfigError) as caught:
        load_bench(path)
    assert words in str(caught.value)
    assert "bench.yaml:" in str(caught.value)


def test_what_a_bench_cannot_do_is_said_before_anything_moves(tmp_path):
    path = write_bench(tmp_path)
    text = path.read_text()
    path.write_text(text[: text.index("glass:\n  out_mm")] + text[text.index("camera:\n  backend") :])
    with pytest.raises(ConfigError, match=r"say glass\.out_mm"):
        load_bench(path)


def test_forecast_counts_moves_by_hand(bench):
    """One pair: glass in place, target 0.5 mm away along x, approach 0.3 mm from below on the way back."""
    steps = steps_of(bench, ONE_SHIFT.format("{along: [1.0, 0.0, 0.0], mm: 0.5}") + "settle_s: 2.0\n")
    said = forecast(bench, idle_stage(bench), steps)
    assert said.frames == 2
    assert said.violations == ()
    assert {name: mm for name, mm in said.travel_mm.items() if mm} == {"target_x": pytest.approx(0.5)}
    # 0.5 mm at a = 100 mm/s2 never reaches 10 mm/s: 2 sqrt(d/a); axis settles 0.2 s; 2 s for each frame
    assert said.duration_s == pytest.approx(
        2 * math.sqrt(0.5 / 100.0) + 0.2 + 2 * (2.0 + 0.1 + 0.05 + 0.002), rel=0.05
    )
    assert said.raw_bytes == pytest.approx(2 * 2 * 96 * 96, rel=0.5)


def test_every_frame_of_a_step_takes_its_time(bench):
    once = steps_of(bench, ONE_SHIFT.format("{along: [1.0, 0.0, 0.0], mm: 0.5}"))
    often = [replace(step, frames=100 * step.frames) for step in once]
    few_s, many_s = (forecast(bench, idle_stage(bench), steps).duration_s for steps in (once, often))
    assert many_s - few_s == pytest.approx(2 * 99 * (0.05 + 0.002))


def test_violations_are_found_without_opening_anything(bench):
    text = ONE_SHIFT.format("{along: [1.0, 0.0, 0.0], mm: 60.0}")
    said = forecast(bench, idle_stage(bench), steps_of(bench, text))
    assert [violation.step for violation in said.violations] == [1]
    assert "outside its limits" in said.violations[0].text


def test_keep_out_is_judged_before_anything_moves(bench):
    """Towards the camera the glass is in the way: the near ball touches the plane."""
    text = "experiment: target\nglass: {z_mm: [0.0, -5.0, 5.0]}\n"
    said = forecast(bench, idle_stage(bench), steps_of(bench, text))
    assert [violation.step for violation in said.violations] == [2]
    assert "would bring the target to -5.00 mm from near" in said.violations[0].text
    sideways = steps_of(bench, "experiment: target\nclear: {z_mm: [20.0]}\n")
    assert forecast(bench, idle_stage(bench), sideways).violations == ()


def test_no_axis_no_displacement(tmp_path):
    path = write_bench(tmp_path)
    text = path.read_text()
    path.write_text(text.replace("carries: target, along: y", "carries: target, along: x"))
    with pytest.raises(PlanError, match="no axis moves the target along y"):
        steps_of(load_bench(path), SHIFT)


places = st.fixed_dictionaries(
    {
        "glass_y": st.sampled_from([-130.0, 0.0]),
        "glass_x": st.sampled_from([0.0, 5.0]),
        "glass_z": st.sampled_from([0.0, 30.0]),
        "target_x": st.sampled_from([0.0, 1.0]),
        "target_z": st.sampled_from([0.0, -10.0]),
    }
)


@settings(max_examples=200, deadline=None)
@given(start=places, end=places)
def test_glass_never_travels_sideways_in_front_of_the_target(bench, start, end):
    here = bench.home_mm | start
    for move in route(bench, here, bench.home_mm | end):
        assert move
        if "glass_y" in move or "glass_x" in move:
            assert here["glass_z"] == 30.0
            assert "glass_z" not in move
        here |= move
    assert here == bench.home_mm | end


def test_what_an_older_version_did_not_know_of_a_step_leaves_its_hash_as_it_was():
    """Runs that were begun before steps had groups and gaps can be resumed."""
    step = Step(0, "a", (("x", 0.0),), 0.0, 0, 2, "clear", "chessboard", True)
    tree = asdict(step)
    del tree["group"], tree["gaps_at_most"], tree["pulses"]
    assert steps_hash([step]) == digest([tree])
    assert steps_hash([replace(step, group=2)]) != steps_hash([step])
    assert steps_hash([replace(step, gaps_at_most=0.1)]) != steps_hash([step])
