"""The open bench as an object, and its prompt fed by a pipe: the same verbs, values and errors."""

import io
import re

import pytest
import yaml

from daq.bench.bench_file import load_bench
from daq.bench.bench_session import BenchSession, open_session
from daq.errors import PlanError, RunUsageError
from rtpiv.command_line.cli import DONE, USAGE, main
from stages.errors import DeviceLost, MotionStopped, NotReferenced, Obstructed, OutOfRange, StageUsageError
from tests.daq.small_bench import FILES_CAMERA, write_bench


@pytest.fixture
def path(tmp_path):
    return write_bench(tmp_path, camera=FILES_CAMERA)


@pytest.fixture
def bench(path):
    with open_session(path, simulate=True) as session:
        yield session


@pytest.fixture
def piped(path, monkeypatch, capsys):
    """Obey lines as `rtpiv bench stage < lines` does; exit code, output, errors."""

    def run(lines, *options):
        monkeypatch.setattr("sys.stdin", io.StringIO(lines))
        code = main(["bench", "stage", "--bench", str(path), "--simulate", *options])
        said = capsys.readouterr()
        return code, said.out, said.err

    return run


# ---- the object --------------------------------------------------------------------------------


def test_references_last_as_long_as_the_session(bench):
    """isel and Grbl forget them with every program: homing and jogging were never possible after each other."""
    assert set(bench.where().values()) == {None}
    with pytest.raises(NotReferenced):
        bench.move(glass_y=-20.0)
    homed = bench.home()
    assert None not in homed.values()
    arrived = bench.move(rail_z=0.0, camera_x=0.0, camera_y=0.0)
    assert arrived["rail_z"].measured_mm == pytest.approx(0.0, abs=0.01)
    assert bench.jog(rail_z=+12.5)["rail_z"].measured_mm == pytest.approx(12.5, abs=0.01)
    assert bench.where()["rail_z"] == pytest.approx(12.5, abs=0.01)
    assert bench.simulation.true_mm()["rail_z"] == pytest.approx(12.5, abs=0.1)


def test_some_axes_alone_and_in_order(bench):
    said = []
    bench.home("target_z", "glass_z", tell=said.append)
    assert said == ["glass_z", "target_z"]
    assert {name for name, mm in bench.where().items() if mm is not None} == {"target_z", "glass_z"}


def test_errors_are_those_of_every_verb(bench):
    bench.home()
    with pytest.raises(OutOfRange):
        bench.move(rail_z=5000.0)
    with pytest.raises(StageUsageError, match="no axis 'rail_q'"):
        bench.jog(rail_q=1.0)
    with pytest.raises(RunUsageError, match="axis=mm"):
        bench.move()
    with pytest.raises(RunUsageError, match="axis=mm"):
        bench.move(rail_z=float("nan"))


def test_a_stop_holds_until_it_is_cleared(bench):
    bench.home()
    bench.stop()
    assert bench.held
    with pytest.raises(MotionStopped, match="clear"):
        bench.move(rail_z=0.0)
    with pytest.raises(MotionStopped):
        bench.home()
    assert None not in bench.where().values()  # reading stays allowed
    bench.clear()
    bench.move(rail_z=0.0)


def test_a_lost_controller_is_opened_again(bench):
    bench.home()
    line = bench.simulation.lines["target"]
    line.unplug()
    with pytest.raises(DeviceLost, match="open it again"):  # whoever finds it says so
        bench.where()
    assert bench.where()["target_x"] is None
    line.plug_in()
    assert bench.connect() == ["target"]
    assert bench.connect() == []
    bench.home("target_x", "target_y", "target_z")
    assert bench.where()["target_x"] is not None
    with pytest.raises(RunUsageError, match="no controller nobody"):
        bench.connect("nobody")


def scene_places(path):
    return yaml.safe_load(path.read_text()).get("scene_at_mm", {})


def test_here_moves_the_scene_and_keep_out_with_it(bench, path):
    """Glass and board touch in the scene: once they stand 40 mm away there, 1 mm closer is obstructed."""
    bench.home()
    bench.move(rail_z=0.0, camera_x=0.0, camera_y=0.0, glass_x=0.0)
    bench.move(glass_y=0.0, glass_z=40.0)
    bench.move(target_x=0.0, target_y=0.0, target_z=0.0)
    bench.move(glass_z=39.0)
    taken = bench.here("glass_z")
    assert taken == {"glass_z": pytest.approx(39.0, abs=0.01)}
    with pytest.raises(Obstructed):
        bench.move(glass_z=38.0)
    bench.stage.controllers["target"].close()
    with pytest.raises(PlanError, match="have no position reference"):
        bench.here()
    assert scene_places(path) == {}  # nothing is written before `save`


def test_save_writes_places_and_nothing_else(bench, path):
    old = path.read_text()
    bench.home()
    bench.move(rail_z=0.0)
    assert bench.changes() == ""
    assert bench.save() is None
    taken = bench.here()
    shown = bench.changes()
    kept = bench.save()
    assert kept.read_text() == old
    assert scene_places(path) == taken
    lines = path.read_text().splitlines()
    assert [line for line in lines if not line.startswith("scene_at_mm")] == old.splitlines()
    assert re.search(r"^\+scene_at_mm: \{rail_z: 0\.0", shown, re.MULTILINE)
    assert "identity" not in path.read_text()  # simulated boxes are not yours
    assert load_bench(path).home_mm == pytest.approx(bench.bench.home_mm)
    assert bench.save() is None


def test_a_comment_written_meanwhile_survives(bench, path):
    bench.home()
    bench.here("rail_z")
    path.write_text(path.read_text().replace("scene: ", "# measured by hand\nscene: "))
    bench.save()
    assert "# measured by hand" in path.read_text()
    assert set(scene_places(path)) == {"rail_z"}


def test_identities_of_the_file_do_not_stand_in_the_way_of_its_simulation(path):
    path.write_text(path.read_text().replace("port: /dev/ttyUSB2}", 'port: /dev/ttyUSB2, identity: "serial 1"}'))
    with open_session(path, simulate=True) as session:
        assert "serial" in session.stage.controllers["glass"].identity


def test_closing_is_harmless_when_repeated(path):
    session = open_session(path, simulate=True, home=True)
    session.close()
    session.close()
    assert all(box.is_lost for box in session.stage.controllers.values())


def test_what_cannot_be_homed_leaves_nothing_open(path, mocker):
    mocker.patch.object(BenchSession, "home", side_effect=StageUsageError("no"))
    closed = mocker.spy(BenchSession, "close")
    with pytest.raises(StageUsageError):
        open_session(path, simulate=True, home=True)
    assert closed.call_count == 1


# ---- the prompt, from a pipe -------------------------------------------------------------------


def test_a_script_of_verbs(piped, path):
    code, out, err = piped(
        "# first day\nhome\n\nmove rail_z=0 glass_x=0   # in front of the board\njog rail_z=+2.5\nwhere\n"
        "here rail_z\nsave\nhelp\nquit\nnonsense\n"
    )
    assert code == DONE, err
    assert "homing glass_z" in err
    assert "rail_z is at 2.5" in out
    assert "the scene file holds at rail_z 2.5" in out
    assert "+scene_at_mm: {rail_z: 2.5" in out
    assert "the old file is" in out
    assert "connect [CONTROLLER ...]" in out
    assert scene_places(path)["rail_z"] == pytest.approx(2.5, abs=0.01)


@pytest.mark.parametrize(
    ("lines", "sentence"),
    [
        ("home\nfrobnicate\nmove rail_z=0\n", r"line 2: frobnicate\n.*no verb 'frobnicate'"),
        ("move rail_z=0\nhome\n", r"line 1: move rail_z=0\n.*home it first"),
        ("home\njog rail_z\n", r"line 2: .*\n.*give axis=mm"),
        ("home\nmove rail_z=1 rail_z=2\n", r"line 2: .*\n.*named twice"),
        ("home\nmove\n", r"give at least one axis=mm"),
        ("where now\n", r"where takes no further words"),
        ("home nobody\n", r"no axis nobody"),
        ("home\nstop\nmove rail_z=0\n", r"line 3: .*\n.*clear the stop"),
    ],
)
def test_a_script_ends_at_its_first_error(piped, lines, sentence):
    code, out, err = piped(lines)
    assert code in (USAGE, 3)
    assert re.search(sentence, err), err
    assert "rail_z is at" not in out


def test_home_before_one_verb(piped, path, capsys):
    options = ["--bench", str(path), "--simulate"]
    assert main(["bench", "stage", "jog", "--home", "target_x=+1.5", *options]) == DONE
    assert re.search(r"target_x\D+target\s+\S\s+x\s+\S\s+1\.5", capsys.readouterr().out)
    assert main(["bench", "stage", "move", *options, "--home", "target_x=1.5", "target_y=-2"]) == DONE
    assert re.search(r"target_y\D+target\s+\S\s+y\s+\S\s+-2\.0", capsys.readouterr().out)
    assert main(["bench", "stage", "where", "--home", *options]) == DONE
    assert "unknown" not in capsys.readouterr().out
    assert main(["bench", "stage", "move", "--home", "target_x=wide", *options]) == USAGE
    said = capsys.readouterr()
    assert "give axis=mm" in said.err
    assert "homing" not in said.err  # what makes no sense is said before anything moves
    code, out, _ = piped("where\n", "--home")
    assert code == DONE
    assert "unknown" not in out
