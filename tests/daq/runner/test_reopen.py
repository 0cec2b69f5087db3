"""What a run must be to go on: without doubt, and on the boxes that it began with."""

import json

import pytest

from daq.errors import ResumeRefused, RunDamaged, RunInterrupted
from daq.runner.run_camera import RunCamera
from daq.runner.runner import Runner
from daq.runner.session import Request, Run, begin, reopen, run_session
from daq.runs.frame_accounting import FrameAccounting
from daq.runs.journal import Journal
from daq.runs.run_check import check_run
from rtpiv.command_line.cli import USAGE, main
from stages.errors import WrongDevice
from tests.daq.small_bench import FILES_CAMERA, SHIFT, files_bench, load, write_frames
from tests.daq.small_run import FLOW


@pytest.fixture
def run(tmp_path):
    bench, plan = load(tmp_path, SHIFT, camera=FILES_CAMERA)
    return begin(Request(bench.path, plan.path, simulate=True, correct=False), bench, plan, tmp_path / "runs")


def session(run, controllers=None):
    journal = Journal(run.journal_path)
    known = {} if controllers is None else {"controllers": controllers}
    journal.append("session", utc="now", versions={}, steps_left=8, **known)
    return journal


def test_a_run_in_doubt_is_refused_whatever_followed(run, capsys):
    journal = session(run)
    journal.append("counts", books=FrameAccounting(triggered=3, written=2).to_dict(), flow=FLOW)
    journal.append("end", utc="now", why="BadBalance", error="")
    journal.close()
    with pytest.raises(ResumeRefused, match=r"do not balance .*begin a new run"):
        reopen(run.path)
    assert main(["acquire", "--resume", str(run.path), "--retake"]) == USAGE
    assert "do not balance" in capsys.readouterr().err


def test_a_run_that_began_before_there_were_seals_goes_on(tmp_path):
    """Its lines have none, the new ones do; what is damaged among the new ones is found."""
    files = write_frames(tmp_path / "frames_in", 20)
    bench, plan = load(tmp_path, SHIFT, camera=FILES_CAMERA)
    folder = begin(Request(bench.path, plan.path, correct=False), bench, plan, tmp_path / "runs")

    def leave(progress):
        if progress.step == 3 and not runner.interrupts.is_end_wanted:  # twice would stop the bench
            runner.interrupts.press()

    with files_bench(bench, files) as hardware:
        runner = Runner(hardware, [RunCamera(hardware, folder)], plan.steps, watcher=leave)
        with pytest.raises(RunInterrupted):
            runner.run()
        lines = [json.loads(line) for line in folder.journal_path.read_text().splitlines()]
        about = json.loads((folder.path / "run.json").read_text())
        for record in (*lines, about):
            record.pop("seal")
        folder.journal_path.write_text("".join(json.dumps(line) + "\n" for line in lines))
        (folder.path / "run.json").write_text(json.dumps({**about, "layout": 1}))
        assert reopen(folder.path).again == frozenset()
        Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
    assert check_run(folder.path).is_sound, check_run(folder.path).findings
    data = folder.journal_path.read_bytes()
    last = data.rindex(b'"step":7')
    folder.journal_path.write_bytes(data[:last] + b'"step":6' + data[last + 8 :])
    with pytest.raises(RunDamaged, match="does not agree with its seal"):
        folder.entries()


@pytest.mark.slow
def test_other_controllers_are_refused_before_anything_moves(run):
    """Two of the boxes have changed places: the first session wrote down who was who."""
    pytest.importorskip("harvesters", reason="the simulated camera needs harvesters (extra rtpiv[camera])")
    found = reopen(run.path)

    class Opened(Exception):  # noqa: N818
        pass

    def leave(hardware):
        identities.update({name: box.identity for name, box in hardware.stage.controllers.items()})
        raise Opened

    identities = {}
    with pytest.raises(Opened):
        run_session(Run(found.request, found.bench, found.plan, run), False, before=leave)
    names = [name for name, identity in identities.items() if identity]
    swapped = {**identities, names[0]: identities[names[1]], names[1]: identities[names[0]]}
    session(run, swapped).close()
    with pytest.raises(WrongDevice, match=rf"{names[0]}: .* answers, and the run began with .*; that is the box"):
        run_session(Run(found.request, found.bench, found.plan, run), False, before=leave)
