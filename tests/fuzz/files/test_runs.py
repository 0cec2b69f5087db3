"""Random damage to every file of a run: what is read is what was written, or one of our own errors says that not.

The readers are those of the verbs: resume, check, report, calibrate, evaluate.  One case cannot be told from a
kill: a journal whose last line has lost its end reads as if that line had never been written.
"""

import random
import shutil

import numpy as np
import pytest

from correction.errors import CorrectionError
from daq.errors import DaqError
from daq.runner.session import reopen
from daq.runs.acquired import read_acquired
from daq.runs.done_file import read_done
from daq.runs.pairs import pairs_of
from daq.runs.run_check import check_run
from daq.runs.run_folder import RunFolder
from daq.runs.run_views import bench_scene, first_view, scene_file, target_views
from ground.errors import GroundError
from piv.errors import PivError
from rtpiv.analysis.report.page import Page
from rtpiv.analysis.report.run import account_chapter, displacement_chapter, provenance_chapter
from rtpiv.command_line.cli import DEVICE
from rtpiv.command_line.exit_codes import exit_code
from rtpiv.verbs.calibrate import nominal_scene
from stages.errors import StageError
from tests.daq.small_run import make_old
from tests.fuzz.files.damage import damaged
from tests.slow_cases import slow
from tracer.errors import TracerError

OURS = (DaqError, CorrectionError, PivError, StageError, TracerError, GroundError)
RECORDS = ("run.json", "steps.jsonl", "done.json", "displacements.json")


def report_of(folder):
    """What `rtpiv report` reads of a run."""
    page = Page("a", "b")
    account_chapter(page, folder)
    displacement_chapter(page, folder)
    provenance_chapter(page, folder, "h", [])
    return RunFolder.open(folder.path).about, folder.entries(), read_done(folder), first_view(folder)


def resume_of(folder):
    found = reopen(folder.path)
    return folder.about, folder.entries(), found.again


def calibrate_of(folder):
    nominal_scene(folder.path, None)
    return folder.about, target_views(folder.path), bench_scene(folder.path)


def evaluate_of(folder):
    pairs, scene = pairs_of(folder.path), scene_file(folder.path, folder.path / "out")
    return folder.about, pairs, scene.read_text()


def check_of(folder):
    """`check` never raises, and says that a run is sound only if all of it is as it was."""
    found = check_run(folder.path)
    if not found.is_sound:
        raise DaqError(str(found.findings))
    return report_of(folder), evaluate_of(folder)


READERS = {"resume": resume_of, "check": check_of, "report": report_of,
           "calibrate": calibrate_of, "evaluate": evaluate_of}  # fmt: skip


def outcome(reader, folder):
    """What a reader returns, or None if it refuses by an error of our own."""
    try:
        return reader(folder)
    except OURS as error:
        said, code = str(error), exit_code(error)
    assert "\n" not in said, said
    assert code is not None
    return None


def lost_its_end(name, data, whole, verb):
    """Whether a journal reads as whole lines of the original and a torn one; `check` knows better by the hash."""
    kept = data[: data.rfind(b"\n") + 1]
    return name == "steps.jsonl" and verb != "check" and len(kept) < len(whole) and whole.startswith(kept)


def fuzz(folder, name, verb, count, seed):
    """Damage one file in many ways; return how many were refused."""
    path, reader, rng = folder.path / name, READERS[verb], random.Random(f"{name} {verb} {seed}")
    whole = path.read_bytes()
    right = outcome(reader, folder)
    assert right is not None
    refused = 0
    for _ in range(count):
        path.write_bytes(damaged(whole, rng))
        found = outcome(reader, folder)
        refused += found is None
        if found is not None and not lost_its_end(name, path.read_bytes(), whole, verb):
            assert found == right, path.read_bytes()
    path.write_bytes(whole)
    assert outcome(reader, folder) == right
    return refused


def prepared(run, verb):
    if verb == "resume":
        (run.path / "done.json").unlink()
    return run


CASES = [(name, verb) for name in RECORDS for verb in READERS if (name, verb) != ("done.json", "resume")]
IGNORED = {("displacements.json", "resume"), ("displacements.json", "calibrate"), ("done.json", "calibrate"),
           ("steps.jsonl", "calibrate"), ("done.json", "evaluate")}  # fmt: skip


@pytest.mark.parametrize("count", [20, slow(5000)])
@pytest.mark.parametrize(("name", "verb"), CASES)
def test_damaged_records_are_refused_or_read_as_they_were(done_run, name, verb, count):
    refused = fuzz(prepared(done_run, verb), name, verb, count, 1)
    assert refused > count // 2 or (name, verb) in IGNORED


@pytest.mark.slow
@pytest.mark.parametrize(("name", "verb"), CASES)
def test_records_without_seals_raise_nothing_but_our_own_errors(done_run, name, verb):
    """Runs of the first layout: types alone cannot find every damage, but none is a traceback."""
    make_old(done_run)
    run, rng = prepared(done_run, verb), random.Random(f"{name} {verb}")
    path = run.path / name
    whole = path.read_bytes()
    for _ in range(20):
        path.write_bytes(damaged(whole, rng))
        outcome(READERS[verb], run)


def test_damaged_frames_are_refused_or_their_pixels_are_right(done_run):
    """Anywhere in the file: header, description, pixels, end."""
    path, rng = done_run.frame_path(3), random.Random(5)
    whole, right = path.read_bytes(), read_acquired(path)
    refused = 0
    for number in range(200):
        data = damaged(whole[:2000], rng) + whole[2000:] if number % 2 else damaged(whole, rng)
        path.write_bytes(data)
        try:
            found = read_acquired(path)
        except OURS as error:
            said, code = str(error), exit_code(error)
        else:
            assert np.array_equal(found, right)
            continue
        refused += 1
        assert "000003.tif" in said
        assert code == DEVICE, said
    assert refused > 100


def test_a_run_whose_files_are_missing_is_said(whole_run, tmp_path):
    for name in RECORDS:
        for verb, reader in READERS.items():
            run = RunFolder(shutil.copytree(whole_run.path, tmp_path / f"{verb} {name}"))
            (run.path / name).unlink()
            outcome(reader, run)
