"""A bench whose glass cannot look for its reference: a person says where it stands, and the run says so."""

import io

import pytest
import yaml

from daq.bench.bench_file import load_bench
from daq.bench.bench_session import open_session
from daq.bench.kinds import StageKind
from daq.plans.plan import load_plan
from daq.runner.run_camera import RunCamera
from daq.runner.runner import Runner
from daq.runner.session import Request, begin
from rtpiv.command_line.cli import DONE, USAGE, main
from stages.errors import OutOfRange, StageUsageError
from tests.daq.small_bench import (
    FILES_CAMERA,
    GLASS_CHANNELS,
    SHIFT,
    SIMULATED_GLASS,
    files_bench,
    with_glass,
    write_bench,
    write_frames,
)

pytestmark = pytest.mark.filterwarnings("ignore:.* is moved by:RuntimeWarning")
STANDS = {"glass_x": -25.0, "glass_y": -88.3333, "glass_z": 18.0}  # a third of the travel, behind the offset


@pytest.fixture
def path(tmp_path):
    return with_glass(write_bench(tmp_path, camera=FILES_CAMERA), SIMULATED_GLASS)


def test_a_session_takes_a_persons_word(path):
    with open_session(path, simulate=True) as bench:
        with pytest.raises(StageUsageError, match="glass_z is homed by hand"):
            bench.home()
        assert set(bench.where().values()) == {None}
        with pytest.raises(OutOfRange):
            bench.confirm(glass_z=51.0)
        with pytest.raises(StageUsageError, match="itself"):
            bench.confirm(rail_z=0.0)
        bench.confirm(**STANDS)
        assert None not in bench.home().values()
        for name, mm in bench.simulation.true_mm().items():
            assert bench.where()[name] == pytest.approx(mm, abs=0.1)


def test_the_prompt_takes_it_too(path, monkeypatch, capsys):
    words = " ".join(f"{name}={mm}" for name, mm in STANDS.items())
    for lines, code in ((f"confirm {words}\nhome\nmove glass_z=30\n", DONE), ("home\n", USAGE)):
        monkeypatch.setattr("sys.stdin", io.StringIO(lines))
        assert main(["bench", "stage", "--bench", str(path), "--simulate"]) == code
        said = capsys.readouterr()
        assert "glass_z is at 30.0" in said.out if code == DONE else "confirm glass_z=MM" in said.err


def test_the_journal_keeps_it(path, tmp_path):
    bench = load_bench(path)
    (tmp_path / "plan.yaml").write_text(SHIFT)
    plan = load_plan(tmp_path / "plan.yaml", bench)
    folder = begin(Request(bench.path, plan.path, correct=False), bench, plan, tmp_path / "runs")
    with files_bench(bench, write_frames(tmp_path / "frames_in", 20), home=False) as hardware:
        hardware.stage.home(ask=STANDS.__getitem__)
        Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
    session = next(entry for entry in folder.entries() if entry["kind"] == "session")
    assert session["said_mm"] == STANDS


def test_whoever_is_there_is_asked_for_each_axis_once(path):
    asked = []

    def ask(axis):
        asked.append(axis)
        return STANDS[axis]

    with open_session(path, simulate=True) as bench:
        bench.home(ask=ask)
        bench.home(ask=ask)
    assert sorted(asked) == sorted(GLASS_CHANNELS)


def test_files_of_a_library_lie_beside_the_bench_file(path, mocker):
    tree = yaml.safe_load(path.read_text())
    tree["stages"]["controllers"]["glass"] = {"driver": "micromanager", "homing": "hand", "config": "glass.cfg"}
    path.write_text(yaml.safe_dump(tree))
    bench = load_bench(path)
    opened = mocker.patch("daq.bench.kinds.Stage.open")
    StageKind().open(bench.table.stages, bench, mocker.Mock())
    assert opened.call_args[0][0].controllers["glass"].config == str(path.parent.resolve() / "glass.cfg")
