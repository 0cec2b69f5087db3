"""A rehearsal: a bench with its truth, each kind of fault does what its name says, bad input is refused."""

import re
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import pytest

from daq import photograph
from daq.bench.bench_file import load_bench
from daq.bench.fault_table import OF_A, things_of
from daq.bench.opened import start_simulation
from daq.bench.rehearsal import Rehearsal
from daq.errors import CameraError, RunUsageError
from ground.errors import ConfigError
from rtpiv.options import call_of, parser
from sim.event_log import read_event_log
from sim.mechanics.clock import VirtualClock
from sim.rehearsed import Rehearsed
from sim.stages import SimulatedStages
from stages.errors import DeviceLost, StageError
from stages.stage import Stage
from tests.daq.bench.test_timing_kind import bench_with
from tests.daq.small_bench import write_bench
from tests.slow_cases import slow_but
from tests.stages.benches import screws, stages_table

pytest_plugins = ("pytester",)
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write_bench(tmp_path_factory.mktemp("bench"), side_px=96)


@pytest.fixture
def rehearsed(path):
    """Open a bench with faults."""
    opened = []

    def open_one(*faults, seed=None):
        opened.append(Rehearsed(path, faults, seed))
        return opened[-1]

    yield open_one
    for bench in opened:
        bench.close()


def fault(what, of, **more):
    return {"what": what, "of": of, **more}


def _to_and_fro(bench, axis, far_mm):
    for place in range(1000):
        bench.move(**{axis: far_mm * (place % 2)})


def test_the_truth_stands_beside_the_bench(rehearsed):
    bench = rehearsed()
    bench.home()
    bench.move(target_z=-5.0)
    assert bench.true_mm()["target_z"] == pytest.approx(-5.0, abs=0.1)
    assert bench.true_mm()["target_z"] != bench.where()["target_z"]  # a screw has play
    assert "MOV" in bench.event_log().bytes_to("target")
    assert not bench.event_log().of_kind("exposed")


def test_an_unplugged_camera_costs_no_real_time(rehearsed):
    bench = rehearsed(fault("unplug", "camera", at_s=0.0))
    bench.home()
    begun_s = time.monotonic()
    for _ in range(2):
        with pytest.raises(CameraError, match="does not answer"):
            photograph(bench)
    assert time.monotonic() - begun_s < 5.0  # timeout_s of this bench is 60 s


@pytest.mark.slow
def test_the_seed_is_that_of_the_world_and_repeats_it_to_the_byte(path):
    def look(seed):
        with Rehearsed(path, seed=seed) as bench:
            bench.home()
            bench.move(glass_z=20.0, target_x=2.0)
            return photograph(bench).tobytes(), bench.event_log().text()

    first, again, other = look(3), look(3), look(4)
    assert first == again
    assert first[0] != other[0]
    assert '"exposed"' in first[1]


def test_a_cable_out_by_a_word(rehearsed):
    bench = rehearsed(fault("unplug", "target", word="MOV", nth=2))
    bench.home()
    bench.move(target_x=1.0)
    sent = bench.event_log().bytes_to("target").count("MOV")
    with pytest.raises(DeviceLost):
        _to_and_fro(bench, "target_x", 3.0)
    assert bench.event_log().faults == ["unplug of target at word 'MOV', time 2"]
    assert bench.event_log().bytes_to("target").count("MOV") == 1 <= sent  # the second did not reach the box


@pytest.mark.slow
def test_a_cable_out_by_time_in_the_middle_of_a_motion(rehearsed):
    bench = rehearsed(fault("unplug", "rail", at_s=300.0))
    bench.home()
    with pytest.raises(DeviceLost):
        _to_and_fro(bench, "rail_z", 100.0)
    struck = bench.event_log().of_kind("fault")
    assert [event.time_s for event in struck] == [300.0]


@pytest.mark.parametrize(
    "what", slow_but(("late", "split", "lost", "cut", "doubled", "garbled", "mute", "restart"), "mute")
)
def test_wires(rehearsed, what):
    """A late or doubled answer is lived with or refused; silence and a box that has forgotten are told."""
    numbers = {"late": {"delay_s": 0.05}, "split": {"delay_s": 0.05}, "restart": {"off_s": 1.0}}.get(what, {})
    bench = rehearsed(fault(what, "target", word="MOV", **numbers))
    bench.home()
    failed = False
    try:
        bench.move(target_x=3.0)
    except StageError:
        failed = True
    assert len(bench.event_log().faults) == 1
    if what in ("mute", "restart"):
        assert failed
    if what in ("late", "split"):
        assert bench.true_mm()["target_x"] == pytest.approx(3.0, abs=0.1)
    if not failed:
        assert bench.where()["target_x"] == pytest.approx(bench.true_mm()["target_x"], abs=0.1)


@pytest.mark.slow
def test_a_knock_moves_what_no_controller_notices(rehearsed):
    bench = rehearsed(fault("knock", "glass_x", word="move abs", by_mm=0.4))
    bench.home()
    bench.move(glass_x=10.0)
    assert bench.where()["glass_x"] == pytest.approx(10.0, abs=0.01)
    assert bench.true_mm()["glass_x"] == pytest.approx(10.4, abs=0.1)
    assert not bench.event_log().violations


@pytest.mark.slow
def test_a_motor_that_stalls_stays_where_it_is(rehearsed):
    bench = rehearsed(fault("stall", "rail_z", word="@0A"))
    bench.home()
    before_mm = bench.true_mm()["rail_z"]
    bench.jog(rail_z=30.0)  # isel counts the steps that it gives
    assert bench.true_mm()["rail_z"] == pytest.approx(before_mm, abs=1e-6)


@pytest.mark.slow
def test_a_camera_that_is_late_torn_or_gone(rehearsed):
    whole = photograph(rehearsed())
    before_s = time.monotonic()
    assert (photograph(rehearsed(fault("late", "camera", at_s=0.1, delay_s=0.4))) == whole).all()
    assert time.monotonic() - before_s > 0.4
    torn = rehearsed(fault("cut", "camera", at_s=0.1))
    photograph(torn)
    assert len(torn.event_log().of_kind("exposed")) == 2  # it was taken again
    with pytest.raises(CameraError):
        photograph(rehearsed(fault("unplug", "camera", at_s=0.1)))


@pytest.mark.slow
def test_the_lamp_grows_dim(rehearsed):
    bright = photograph(rehearsed()).astype(float).mean()
    dim = photograph(rehearsed(fault("dim", "lamp", at_s=0.1, share=0.5))).astype(float).mean()
    assert 0.4 < dim / bright < 0.65


# ---- what is refused -----------------------------------------------------------------------------

WRONG = [
    ("{what: unplug, of: targt, at_s: 1.0}", "there is no 'targt' on this bench; there are rail, portal"),
    ("{what: knock, of: target, at_s: 1.0}", "target is a box, which cannot knock; say one of unplug, mute"),
    ("{what: garbled, of: camera, at_s: 1.0}", "camera is a camera, which cannot garbled"),
    ("{what: fire, of: target, at_s: 1.0}", "what"),
    ("{what: unplug, of: target}", "say when, by one of step, at_s, word"),
    ("{what: unplug, of: target, at_s: 1.0, word: MOV}", "say when, by one of step, at_s, word"),
    ("{what: unplug, of: camera, word: MOV}", "a camera gets no commands on a port; give step or at_s"),
    ("{what: unplug, of: target, at_s: 1.0, nth: 2}", "nth: it counts how often a word is said"),
    ("{what: late, of: target, at_s: 1.0}", "say delay_s as well"),
    ("{what: unplug, of: target, at_s: 1.0, share: 0.5}", "share: unplug takes no such number"),
    ("{what: unplug, of: target, step: 3}", "an open bench has no steps"),
    ("{what: unplug, of: target, at: 1.0}", "unknown key 'faults.2.at'"),
]


@pytest.mark.parametrize(("entry", "words"), WRONG, ids=[words for _, words in WRONG])
def test_what_cannot_go_wrong_is_said_with_its_line(path, tmp_path, entry, words):
    file = tmp_path / "faults.yaml"
    file.write_text(f"faults:\n  - {{what: dim, of: lamp, at_s: 1.0, share: 0.5}}\n  - {entry}\n")
    with pytest.raises(ConfigError) as caught:
        Rehearsed(path, faults=file)
    assert str(caught.value).startswith(f"{file}:3: ")
    assert words in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_other_bad_input_is_one_sentence(path, tmp_path):
    bench = load_bench(path)
    with pytest.raises(ConfigError, match="the plan has 4 steps, so step 5 never begins"):
        Rehearsal([fault("mute", "target", step=5)]).of(bench, steps=4)
    with pytest.raises(ConfigError, match=r"^faults: .*no such"):
        Rehearsal([fault("dim", "lamp", at_s=1.0, share=0.5, by_mm=1.0)]).of(bench)
    with pytest.raises(RunUsageError, match="seed -1: use a whole number from 0 to"):
        Rehearsal(seed=-1).of(bench)
    with pytest.raises(RunUsageError, match="only a rehearsal keeps what happens"):
        read_event_log(tmp_path)
    with pytest.raises(ConfigError, match="cannot be read"):
        Rehearsal(tmp_path / "none.yaml").of(bench)


def test_the_light_of_a_flow_is_no_lamp(path):
    rehearsed = Rehearsal([fault("dim", "lamp", step=1, share=0.5)]).of(load_bench(path), steps=2)
    with pytest.raises(RunUsageError, match="a flow is lit by the laser, which cannot be dimmed"):
        start_simulation(rehearsed, "flow")


def test_every_thing_of_a_bench_has_its_faults(path, tmp_path):
    assert {"timing unit", *things_of(load_bench(path)).values()} == set(OF_A)
    assert things_of(bench_with(tmp_path))["laser"] == "timing unit"


# ---- the fixture ---------------------------------------------------------------------------------


@pytest.fixture
def lab(pytester, path, monkeypatch):
    """Run a test of a lab that has the fixture."""

    def run(body):
        pytester.makepyfile(f"def test_it(rehearse):\n    bench = rehearse({str(path)!r}, {body}")
        return pytester.runpytest_inprocess("-q", "-p", "rtpiv_pytest")

    return run


def test_the_fixture_fails_a_test_whose_fault_has_never_struck(lab):
    said = lab("faults=[dict(what='mute', of='target', word='XYZ')])\n    bench.home()\n")
    said.stdout.fnmatch_lines(["*a fault has never struck: mute of target at word 'XYZ'*"])
    said.assert_outcomes(passed=1, errors=1)


@pytest.mark.slow
def test_the_fixture_is_content_with_what_is_right(lab):
    lab("seed=1)\n    bench.home()\n").assert_outcomes(passed=1)


def test_every_pytest_of_the_computer_loads_it_and_nothing_else():
    """A stranger's project may have a folder sim of its own, which must not meet ours."""
    code = (
        "import sys, rtpiv_pytest; names = {m.partition('.')[0] for m in sys.modules};"
        "print(*names & {'rtpiv', 'sim', 'daq', 'ground', 'numpy', 'pydantic', 'yaml'});"
        "print(*(f for f in sys.meta_path if 'Neighbour' in repr(f)))"
    )
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert ran.stdout.split() == []


def test_the_entry_point_is_called_like_its_module():
    """So that ``-p rtpiv_pytest`` and an installed rtpiv are one plug-in, not two."""
    about = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert about["project"]["entry-points"]["pytest11"] == {"rtpiv_pytest": "rtpiv_pytest"}


def test_the_command_line_says_the_same():
    for said, simulate in (
        (["--faults", "f.yaml", "--seed", "3"], Rehearsal(Path("f.yaml"), 3)),
        (["--simulate", "--seed", "3"], Rehearsal(None, 3)),
        (["--simulate"], True),
        ([], False),
    ):
        read = vars(parser().parse_args(["acquire", "plan.yaml", *said]))
        assert call_of("acquire", read)[1]["simulate"] == simulate


# The fixture that watches every test sees what happens on its benches: these tests fail if it does not.


TESTS = Path(__file__).resolve().parents[1]
MAKES_BENCH = re.compile(
    r"from sim\.(stages|rehearsed|watched_world|witness)|Simulated(Stages|Bench)|[-\"]-simulate\b|simulate=True"
)
BEYOND = """
from sim.mechanics.clock import VirtualClock
from sim.stages import SimulatedStages
from tests.stages.benches import screws, stages_table
table, clock = stages_table("zaber_ascii"), VirtualClock()
world = SimulatedStages(table, clock, screws(table))
world.lines["box"].send(b"/1 1 move abs 49000\\n")
clock.sleep_s(100.0)
assert world.witness.judge()
"""


@pytest.fixture
def made():
    table, clock = stages_table("zaber_ascii"), VirtualClock()
    world = SimulatedStages(table, clock, screws(table))
    with world.in_process() as offered:
        yield world, clock, offered


def drive(world, clock, command):
    world.lines["box"].send(command)
    clock.sleep_s(100.0)


@pytest.mark.provokes("limit")
def test_a_motion_beyond_its_limits(made):
    world, clock, _ = made
    drive(world, clock, b"/1 1 move abs 49000\n")


@pytest.mark.provokes("limit")
def test_a_motion_in_another_process():
    subprocess.run([sys.executable, "-c", BEYOND], check=True)


@pytest.mark.provokes("stop")
def test_a_motion_after_a_stop(made):
    world, clock, offered = made
    with Stage.open(offered, clock) as stage:
        stage.stop()
        clock.sleep_s(1.0)
        drive(world, clock, b"/1 1 move abs 4000\n")


def test_a_motion_after_a_stop_that_is_cleared(made):
    world, clock, offered = made
    with Stage.open(offered, clock) as stage:
        stage.stop()
        clock.sleep_s(1.0)
        stage.clear_stop()
        drive(world, clock, b"/1 1 move abs 4000\n")


def test_a_stop_of_another_program_is_over_with_it(made):
    world, clock, offered = made
    with Stage.open(offered, clock) as stage:
        stage.stop()
        clock.sleep_s(1.0)
    with Stage.open(offered, clock):
        drive(world, clock, b"/1 1 move abs 4000\n")


def test_folders_with_benches_import_the_witness():
    watched = [path.parent for path in TESTS.rglob("conftest.py") if "witnesses" in path.read_text("utf-8")]
    making = [path for path in TESTS.rglob("test_*.py") if MAKES_BENCH.search(path.read_text("utf-8"))]
    unwatched = [str(path.relative_to(TESTS)) for path in making if not {*watched} & {*path.parents}]
    assert len(making) > 40
    assert not unwatched, "import tests.watched_benches.witnesses in the conftest.py of their folders"
