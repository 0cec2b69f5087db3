"""kill -9 of the runner, of the camera's process and of the whole bench, at random times, in every kind of run.

Afterwards nothing that was acknowledged may be missing, nothing may be there twice, a stream must have kept what
it had, and every frame must show the stop that it is filed under: the simulated camera prints its true positions
into each.  RTPIV_KILLS says how many kills in all (default 45: one run of each kind for each victim, a minute of a
core each).  On a busy machine a run takes longer and is waited for as long as it writes frames.
"""

import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import tifffile

from daq.bench.bench_file import load_bench
from daq.plans.plan import load_plan
from daq.runs.raw_frame import read_raw
from daq.runs.run_check import check_run
from daq.runs.run_folder import RunFolder, frame_entries, steps_on_disk
from rtpiv.command_line.cli import DEVICE, INTERRUPTED
from tests.daq.small_bench import write_bench
from tests.system.misfiled import find_misfiled

pytest.importorskip("harvesters", reason="the camera needs harvesters (extra rtpiv[camera])")

KILLS = int(os.environ.get("RTPIV_KILLS", "45"))
VICTIMS = ("runner", "camera", "bench")
PLANS = {
    "target": "experiment: target\nclear: {z_mm: [0.0, -1.0, -2.0, -3.0, -4.0]}\n"
    "glass: {z_mm: [0.0, -0.5, -1.0]}\nframes: 20\n",
    "shift": "experiment: shift\nviews: [glass]\ndisplacements: [{along: [1, 0, 0], mm: 0.5}]\nrepeats: 60\n",
    "stream": "experiment: stream\nview: glass\nframes: 400\n",
}
COMMON = "PixelFormat: Mono12p, ExposureTime: 500.0, "
SOFTWARE = COMMON + 'TriggerSelector: FrameStart, TriggerMode: "On", TriggerSource: Software'
FREE = COMMON + 'TriggerMode: "Off", AcquisitionFrameRateEnable: true, AcquisitionFrameRate: 60.0'
SPEED = "60"
PATIENCE_S = 120.0  # without a line in the journal
KILLS_A_RUN = 6


class Campaign:
    """One run that is killed again and again."""

    def __init__(self, folder, kind, victim, seed):
        self.folder, self.victim, self.rng = folder, victim, random.Random(seed)
        settings = FREE if kind == "stream" else SOFTWARE
        camera = f"camera:\n  backend: harvesters\n  options: {{cti: {folder}/links/camera.cti}}\n"
        camera += f"  settings: {{{settings}}}\n  timeout_s: 60.0\n  back_within_s: 8.0\n"
        path = write_bench(
            folder,
            side_px=64,
            simulation="samples: 1\nprints_truth: true\nis_misaligned: false",
            camera=camera,
            is_brisk=False,
        )
        if victim == "bench":
            text = path.read_text()
            for name in ("rail", "portal", "glass", "target"):
                text = re.sub(
                    rf"(  {name}: \{{driver: \w+, port: )[^}}]+\}}", rf"\g<1>{folder}/links/{name}}}", text
                )
            path.write_text(text)
        (folder / "links").mkdir()
        (folder / "plan.yaml").write_text(PLANS[kind])
        self.shows = "chessboard" if kind == "target" else "particles"
        self.corrects = [] if kind == "shift" and victim == "runner" else ["--no-correct"]
        self.bench_process, self.exposures = None, 0
        self.runner = None
        self.kills = self.sessions = 0
        self.kept = []

    def start(self):
        """Begin the run, or go on with it."""
        if self.victim == "bench" and (self.bench_process is None or self.bench_process.poll() is not None):
            self._start_bench()
        simulate = [] if self.victim == "bench" else ["--simulate"]
        runs = list((self.folder / "runs").glob("*_plan"))
        words = (
            ["acquire", "--resume", str(runs[0])]
            if runs
            else ["acquire", "plan.yaml", "-o", "runs", *self.corrects, *simulate]
        )
        command = [sys.executable, "-m", "rtpiv.command_line.cli", *words, "--home"]
        where = {"cwd": self.folder, "env": os.environ | {"TMPDIR": str(self.folder)}}
        with (self.folder / "errors.txt").open("ab") as errors:
            self.runner = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=errors, **where)
        self.sessions += 1

    def _start_bench(self):
        ready = self.folder / "links" / "ready"
        ready.unlink(missing_ok=True)
        words = [
            str(self.folder / "bench.yaml"),
            str(self.folder / "links"),
            self.shows,
            SPEED,
            str(self.exposures),
        ]
        self.bench_process = subprocess.Popen(
            [sys.executable, "-m", "tests.system.emulator", *words], env=os.environ | {"TMPDIR": str(self.folder)}
        )
        self.exposures += 100_000
        end_s = time.monotonic() + PATIENCE_S
        while not ready.exists() and self.bench_process.poll() is None and time.monotonic() < end_s:
            time.sleep(0.02)
        assert ready.exists()

    @property
    def run(self):
        found = list((self.folder / "runs").glob("*_plan"))
        return RunFolder(found[0]) if found else None

    def ended(self):
        """Exit code of the session, which may take its time as long as its journal grows."""
        size, end_s = -1, time.monotonic() + PATIENCE_S
        while self.runner.poll() is None and time.monotonic() < end_s:
            grown = self.run.journal_path.stat().st_size if self.run and self.run.journal_path.exists() else 0
            if grown != size:
                size, end_s = grown, time.monotonic() + PATIENCE_S
            time.sleep(0.1)
        said = (self.folder / "errors.txt").read_text()[-2000:]
        assert self.runner.poll() is not None, f"nothing was written for {PATIENCE_S:g} s; the run said: {said}"
        return self.runner.returncode

    def wait_for_frames(self):
        """Let the session come to life, so that kills do not all meet a starting interpreter."""
        before = len(self.kept[-1][0]) if self.kept else 0
        want = before + self.rng.choice((0, 1, 2, 5, 20, 60))
        end_s = time.monotonic() + PATIENCE_S
        while self.runner.poll() is None and time.monotonic() < end_s:
            run = self.run
            if run is not None and run.journal_path.exists() and len(frame_entries(run.entries())) > want:
                return
            time.sleep(0.02)

    def strike(self):
        """Kill the victim; True if there was one."""
        process = {"runner": self.runner, "bench": self.bench_process}.get(self.victim)
        pid = camera_of(self.runner.pid) if self.victim == "camera" else process.pid
        if pid is None or self.runner.poll() is not None:
            return False
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            return False
        self.kills += 1
        if self.victim != "camera":
            process.wait()
        return True

    def look(self):
        """What is on the disk is right at any moment: acknowledged frames are there, and finished steps stay."""
        run = self.run
        entries = run.entries()
        frames = frame_entries(entries)
        for entry in frames.values():
            read_raw(run.path / entry["file"], entry["crc32"])
        self.kept.append((set(frames), len(steps_on_disk(entries))))

    def end(self):
        for process in (self.runner, self.bench_process):
            if process is not None and process.poll() is None:
                process.kill()
                process.wait()


def camera_of(pid):
    """Process id of the camera's process below a runner; None if there is none just now."""
    children = Path(f"/proc/{pid}/task/{pid}/children")
    try:
        found = [int(word) for word in children.read_text().split()]
        return next((c for c in found if b"harvesters" in Path(f"/proc/{c}/cmdline").read_bytes()), None)
    except OSError:
        return None


def torment(campaign, kills, is_stream):
    """Run, kill, go on, until so many kills have met their victim and the run has ended by itself."""
    campaign.start()
    while True:
        if campaign.kills < kills:
            campaign.wait_for_frames()
            time.sleep(campaign.rng.uniform(0.0, 1.5 if is_stream else 0.8))
            campaign.strike()
        if campaign.victim == "camera" and campaign.runner.poll() is None and campaign.kills < kills:
            time.sleep(campaign.rng.uniform(0.5, 2.0))  # it comes back by itself
            continue
        code = campaign.ended()
        if campaign.run is not None and campaign.run.is_done:  # killed behind its last line, perhaps
            campaign.look()
            return
        assert code in (DEVICE, INTERRUPTED, -signal.SIGKILL), (campaign.folder / "errors.txt").read_text()[-2000:]
        if campaign.run is not None:
            campaign.look()
        campaign.start()


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("victim", VICTIMS)
@pytest.mark.parametrize("kind", PLANS)
def test_kills(tmp_path, kind, victim):
    wanted, kills, seed = -(-KILLS // (len(VICTIMS) * len(PLANS))), 0, 0
    while kills < wanted:
        folder = tmp_path / f"{kind}{seed}"
        folder.mkdir()
        campaign = Campaign(folder, kind, victim, seed)
        try:
            torment(campaign, min(KILLS_A_RUN, wanted - kills), kind == "stream")
        finally:
            campaign.end()
        assert campaign.kills > 0, "the run is too short to be hit"
        kills, seed = kills + campaign.kills, seed + 1
        run = campaign.run
        frames = frame_entries(run.entries())
        plan = load_plan(folder / "plan.yaml", load_bench(folder / "bench.yaml"))
        planned = [number for step in plan.steps for number in step.numbers]
        if kind == "stream":
            assert all(kept <= set(frames) for kept, _ in campaign.kept)
            assert not [entry for entry in run.entries() if entry["kind"] == "discard"]
            done = json.loads((run.path / "done.json").read_text())
            gaps = {
                n for step in done.get("gaps", ()) for first, last in step["gaps"] for n in range(first, last + 1)
            }
            assert gaps.isdisjoint(frames)
            assert gaps | set(frames) == set(planned)
            assert len(frames) >= len(planned) - 40 * campaign.sessions  # what was under way at a kill is a gap
        else:
            assert sorted(frames) == planned
            assert [steps for _, steps in campaign.kept] == sorted(steps for _, steps in campaign.kept)
        lines = [entry["frame"] for entry in run.entries() if entry["kind"] == "frame"]
        discarded = [n for entry in run.entries() if entry["kind"] == "discard" for n in entry["frames"]]
        assert len(lines) == len(frames) + len(discarded), "a frame is there twice"
        assert {path.name for path in (run.path / "frames").iterdir()} == {f"{n:06d}.tif" for n in frames}
        assert find_misfiled(run.path) == []
        if not campaign.corrects:
            corrected = [tifffile.imread(path) for path in (run.path / "corrected").glob("[0-9]*.tif")]
            assert len(corrected) == len(frames)
        checked = check_run(run.path)
        assert checked.is_sound, checked.findings
