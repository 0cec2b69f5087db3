"""Frames that are gone or damaged are taken again on request, with the rest of their pair, never silently."""

import numpy as np
import pytest

from daq.errors import ResumeRefused, RunDamaged
from daq.runner.run_camera import RunCamera
from daq.runner.runner import Runner
from daq.runner.session import Request, Run, begin, reopen, run_session, steps_to_retake
from daq.runs.run_check import check_run
from daq.runs.run_folder import frame_entries, remaining
from tests.daq.small_bench import FILES_CAMERA, SHIFT, files_bench, load, write_frames


@pytest.fixture
def run(tmp_path):
    """A finished run of eight steps, two frames each: pairs of steps (0, 1), (2, 3) ..."""
    files = write_frames(tmp_path / "frames_in", 60)
    camera = FILES_CAMERA.replace("timeout_s: 0.3", "timeout_s: 30.0")
    (tmp_path / "ring").mkdir()
    np.save(tmp_path / "ring" / "0.npy", np.full((96, 96), 100, np.uint16))
    bench, plan = load(tmp_path, SHIFT + "frames: 2\n", camera=camera, simulation="ring: ring")
    folder = begin(Request(bench.path, plan.path, simulate=True, correct=False), bench, plan, tmp_path / "runs")
    with files_bench(bench, files) as hardware:
        Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
    return bench, plan, folder, files


def flip(path):
    data = bytearray(path.read_bytes())
    data[-100] ^= 4
    path.write_bytes(data)


def again(run, found):
    bench, plan, folder, files = run
    with files_bench(bench, files) as hardware:
        return Runner(hardware, [RunCamera(hardware, folder)], plan.steps, again=found).run()


def test_a_damaged_frame_takes_its_pair_with_it_and_the_books_say_so(run):
    _, plan, folder, _ = run
    (folder.path / "done.json").unlink()
    flip(folder.frame_path(7))  # second frame of step 3, which is displaced from step 2
    before = frame_entries(folder.entries())
    with pytest.raises(RunDamaged, match=r"1 of 16 frames .*000007\.tif.* --retake"):
        reopen(folder.path)
    found = reopen(folder.path, retake=True)
    assert found.again == {2, 3}
    assert [step.index for step in remaining(plan.steps, folder.entries(), found.again)] == [2, 3]
    done = again(run, found.again)
    (discard,) = [entry for entry in folder.entries() if entry["kind"] == "discard"]
    assert discard["frames"] == [4, 5, 6, 7]
    assert discard["why"] == "steps [2, 3] are taken again for a damaged frame"
    assert done["conservation"]["written"] == 16
    assert done["conservation"]["rejected"] == 4
    assert done["conservation"]["imbalance"] == 0
    assert check_run(folder.path).is_sound, check_run(folder.path).findings
    now = frame_entries(folder.entries())
    assert {number for number in now if now[number] != before[number]} == {4, 5, 6, 7}


def test_a_damaged_reference_takes_what_is_displaced_from_it_along(run):
    _, plan, folder, _ = run
    folder.frame_path(0).unlink()
    assert steps_to_retake(folder, plan.steps, folder.entries(), retake=True) == {0, 1}


def test_a_finished_run_is_taken_again_only_where_it_has_to_be(run):
    _, _, folder, _ = run
    with pytest.raises(ResumeRefused, match="is finished; there is nothing to resume"):
        reopen(folder.path)
    with pytest.raises(ResumeRefused, match="all of its frames are right"):
        reopen(folder.path, retake=True)
    folder.frame_path(15).unlink()
    with pytest.raises(ResumeRefused, match="is finished"):
        reopen(folder.path)
    assert reopen(folder.path, retake=True).again == {6, 7}
    assert folder.is_done  # nothing is touched before the bench is open


@pytest.mark.slow
def test_killed_while_taking_again_goes_on(run):
    """Right after the discard is in the journal: the run is open, and a plain resume takes what is missing."""
    pytest.importorskip("harvesters", reason="the simulated camera needs harvesters (extra rtpiv[camera])")
    bench, plan, folder, _ = run
    flip(folder.frame_path(5))
    found = reopen(folder.path, retake=True)

    class Killed(Exception):  # noqa: N818
        pass

    def kill(progress):
        if progress.doing == "exposing":
            raise Killed

    with pytest.raises(Killed):
        run_session(Run(found.request, bench, plan, folder, found.again), True, kill)
    assert not folder.is_done
    assert not (folder.path / "displacements.json").exists()  # of frames that are no more
    assert not folder.frame_path(4).exists()
    left = reopen(folder.path)
    assert left.again == frozenset()
    run_session(Run(left.request, bench, plan, folder), True)
    assert check_run(folder.path).is_sound, check_run(folder.path).findings
