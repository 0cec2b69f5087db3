"""Alignment runs over byte protocols, with a camera that sees the glass where the axes have truly brought it."""

import json
import re

import numpy as np
import pytest

from correction.errors import MoveDoubted
from daq.cameras.files import FilesCamera
from daq.errors import PlanError, RunInterrupted
from daq.runner.alignment_loop import AlignmentLoop
from daq.runner.run_camera import RunCamera
from daq.runner.runner import Runner
from daq.runner.session import Request, begin, reopen
from daq.runs.run_check import check_run
from daq.runs.run_folder import steps_on_disk
from tests.correction.alignment.drawn import drawn, moved
from tests.daq.small_bench import FILES_CAMERA, files_bench, load, write_frames

SIDE_PX = 640
PLAN = "experiment: align\nback_mm: 2.5\nmoves: 2\n"
OFF_MM, CAMERA_OFF_MM = np.array((1.2, -0.9, 0.4)), np.array((-0.2, 0.15, 0.3))


class Seeing(FilesCamera):
    """Frames of the glass as it truly stands."""

    def __init__(self, folder):
        super().__init__(folder, repeat=True)
        self.hardware, self.follows, self.shown = None, np.ones(3), 0

    def _read(self, path):
        if self.hardware is None:
            return super()._read(path)
        self.shown += 1
        bench, true_mm = self.hardware.bench, self.hardware.simulation.true_mm()
        glass = OFF_MM + self.follows * bench.table.offset_mm("glass", true_mm)
        camera = CAMERA_OFF_MM + bench.table.offset_mm("camera", true_mm)
        scene = moved(bench.scene, camera_mm=camera)
        balls = moved(
            bench.scene, glass_mm=np.add(glass, (0.0, 0.0, 50.0))
        ).bodies  # a scene has no glass behind its plane
        return drawn(scene.with_bodies(balls), blur_px=1.0, seed=self.shown, lower_mm=50.0)


@pytest.fixture
def run(tmp_path):
    def make(follows=(1.0, 1.0, 1.0), change=lambda text: text, plan=PLAN):
        bench, plan = load(tmp_path, plan, side_px=SIDE_PX, camera=FILES_CAMERA)
        bench.path.write_text(change(bench.path.read_text()))
        bench, plan = reload(bench, plan)
        folder = begin(Request(bench.path, plan.path, correct=False), bench, plan, tmp_path / "runs")
        return go_on(bench, plan, folder, follows), bench, plan, folder

    def reload(bench, plan):
        from daq.bench.bench_file import load_bench
        from daq.plans.plan import load_plan

        bench = load_bench(bench.path)
        return bench, load_plan(plan.path, bench)

    def go_on(bench, plan, folder, follows):
        said = []
        frames = write_frames(tmp_path / "frames_in", 1, SIDE_PX)

        def carry_out(at=lambda step: None):
            with files_bench(bench, frames, Seeing) as hardware:
                hardware.camera.hardware, hardware.camera.follows = hardware, np.array(follows)
                alignment = AlignmentLoop(hardware, folder, plan.table, said.append)
                runner = Runner(hardware, [RunCamera(hardware, folder)], plan.steps, alignment=alignment)
                at(runner)
                try:
                    runner.run()
                finally:
                    said.append(hardware.simulation.true_mm())
            return said

        return carry_out

    return make


def looks(folder):
    return [entry for entry in folder.entries() if entry["kind"] == "look"]


@pytest.mark.slow
def test_glass_and_camera_come_to_their_places(run):
    carry_out, bench, _, folder = run()
    *said, true_mm = carry_out()
    glass = OFF_MM + bench.table.offset_mm("glass", true_mm)
    camera = CAMERA_OFF_MM + bench.table.offset_mm("camera", true_mm)
    assert np.hypot(*glass[:2]) < 3.0 * np.hypot(*looks(folder)[-1]["glass_sigma_mm"][:2])
    assert np.hypot(*glass[:2]) < 0.08  # at 640 px a pixel is 0.2 mm
    assert 0.0 < glass[2] < 8.0  # before the target, as far as one frame is unsure
    assert np.abs(camera).max() < 0.25
    found = looks(folder)
    assert [entry["tag"] for entry in found] == ["look_0", "look_1", "look_2"]
    assert np.abs(np.subtract(found[0]["glass_mm"], OFF_MM)[:2]).max() < 0.05
    assert list(found[0]["spheres"]) == ["far"]
    assert json.loads((folder.path / "done.json").read_text())["conservation"]["written"] == 3
    assert "near shows no rim of its own" in said[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("follows", "words"),
    [((-1.0, 1.0, 1.0), "glass_x was moved by .* the other way"), ((1.0, 0.0, 1.0), "glass_y .* stands still")],
)
def test_a_wrong_sign_or_a_loose_coupling_ends_it_after_one_move(run, follows, words):
    carry_out, *_, folder = run(follows)
    with pytest.raises(MoveDoubted, match=words):
        carry_out()
    assert steps_on_disk(folder.entries()) == {0, 1}
    assert len(looks(folder)) == 2


def test_a_limit_in_the_way_is_said_before_the_move(run):
    narrow = lambda text: re.sub(r"limits_mm: \[-70.0, 70.0\]", "limits_mm: [-0.5, 70.0]", text)  # noqa: E731
    carry_out, *_, folder = run(change=narrow)
    with pytest.raises(PlanError, match=r"cannot be moved there: glass_x.*nothing was moved"):
        carry_out()
    assert steps_on_disk(folder.entries()) == {0}


@pytest.mark.slow
def test_an_interrupted_alignment_goes_on_from_its_frames(run):
    carry_out, bench, _, folder = run()

    def end_after_two(runner):
        looked = runner._alignment.after

        def after(step, journal):
            looked(step, journal)
            if step.index == 1:
                runner.interrupts.press()

        runner._alignment.after = after

    with pytest.raises(RunInterrupted):
        carry_out(end_after_two)
    assert len(looks(folder)) == 2
    reopen(folder.path)
    *_, true_mm = carry_out()
    assert len(looks(folder)) == 3
    assert np.hypot(*(OFF_MM + bench.table.offset_mm("glass", true_mm))[:2]) < 0.08


def test_no_look_is_taken_once_nothing_need_move(run, monkeypatch):
    """Two moves are allowed; the first look asks for none, so the run is done, and sound."""
    monkeypatch.setattr("daq.runner.alignment_loop.next_targets", lambda bench, planned, look, want: dict(planned))
    carry_out, *_, folder = run()
    carry_out()
    assert [entry["tag"] for entry in looks(folder)] == ["look_0"]
    assert json.loads((folder.path / "done.json").read_text())["steps"] == 1
    assert check_run(folder.path).is_sound


def test_a_look_alone_says_what_would_be_moved(run):
    carry_out, *_ = run(plan=PLAN.replace("moves: 2", "moves: 0"))
    *said, true_mm = carry_out()
    (would,) = [line for line in said if line.startswith("with moves allowed: moving ")]
    assert "glass_x -1." in would
    assert "glass_y +" in would
    assert abs(true_mm["glass_x"]) < 0.01  # play
