"""A disk that fills up while light leaves: the laser goes off at once, and the run is resumed."""

import time

import pytest

from daq.bench.rehearsal import Rehearsal
from daq.errors import DiskError
from daq.pipeline import pipeline as pipeline_module
from daq.runs.raw_frame import write_raw
from daq.runs.run_check import check_run
from rtpiv.verbs.acquire import LiveFrames, acquire
from rtpiv.verbs.resume import resume
from sim import world
from sim.event_log import Kept, read_event_log
from tests.daq.flow_bench import ToldLight, write_flow
from tests.slow_cases import slow

PAIRS = 60  # 2.4 s of light


@pytest.mark.slow
@pytest.mark.parametrize("frames", [6, slow(0), slow(1), slow(25)])
def test_light_ends_with_the_room_on_the_disk(tmp_path, monkeypatch, frames):
    monkeypatch.setattr(world, "LitFlow", ToldLight)
    room, full_s, lit_s = [frames], [], []
    note = Kept.note

    def note_light(kept, time_s, what, *about):
        if what == "light":
            lit_s.append(time.monotonic())
        note(kept, time_s, what, *about)

    monkeypatch.setattr(Kept, "note", note_light)

    def write(path, pixels, about):
        room[0] -= 1
        if room[0] < 0:
            full_s.append(time.monotonic())
            raise DiskError(f"{path}: No space left on device; make room, then resume the run")
        write_raw(path, pixels, about)

    monkeypatch.setattr(pipeline_module, "write_raw", write)
    bench, plan = write_flow(tmp_path, pairs=PAIRS, chunk=PAIRS)
    with pytest.raises(DiskError, match="No space left"):
        acquire(
            plan, bench, tmp_path / "runs", simulate=Rehearsal(seed=1), home=True, operator="me",
            frames=LiveFrames(correct=False),
        )  # fmt: skip
    (path,) = (tmp_path / "runs").iterdir()
    happened = read_event_log(path)
    assert not happened.violations
    assert len(lit_s) >= frames
    assert lit_s[-1] - full_s[0] < 0.5
    room[0] = 10_000
    resume(path, home=True, operator="me")
    assert check_run(path).is_sound
