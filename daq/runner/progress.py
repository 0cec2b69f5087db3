"""Progress of a run for a person: a panel that is drawn anew, or lines of a log."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from daq.bench.elements import CAMERA
from daq.pipeline.stats import PipelineStats
from daq.plans.steps import Step
from daq.runs.frame_accounting import FrameAccounting
from daq.timing.states import LaserState
from ground.plain_words import in_words, quantity
from ground.terminal import show_live

TRUST, LEAST_TRUST_S = 0.03, 1.0  # share of the expected time that has to be measured to weigh as much as it
LEAP = 4.0  # times what it should take is the most that a single frame may slow the others down by


@dataclass
class CameraProgress:
    """Frames of one camera of a session: their account, what waits to be written and corrected, and statistics."""

    accounting: FrameAccounting = field(default_factory=FrameAccounting)
    waiting: tuple[int, int] = (0, 0)
    stats: PipelineStats = field(default_factory=PipelineStats)


@dataclass(kw_only=True)
class Progress(CameraProgress):
    """State of a session and of its first camera; changed by the runner, read by the display.

    Parameters
    ----------
    further : dict
        Further cameras, by name.
    steps, step : int
        Steps of the plan, and the one that is being carried out.
    tag, doing : str
        Its tag, and what happens just now.
    planned, frames : int
        Frames of this session, and those that have been taken.
    begun_s : float
        When the session began, on `time.monotonic`.
    laser : LaserState or None
        Of the laser that the session uses; None if it has none yet.
    readings : dict
        What gauges of the lab showed last, in words.
    remarks : list of str
        What is to be said once.
    """

    steps: int = 0
    step: int = 0
    tag: str = ""
    doing: str = ""
    planned: int = 0
    frames: int = 0
    begun_s: float = field(default_factory=time.monotonic)
    positions_mm: dict[str, float] = field(default_factory=dict)
    further: dict[str, CameraProgress] = field(default_factory=dict)
    laser: LaserState | None = None
    readings: dict[str, str] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)
    _frame_s: dict[int, float] = field(default_factory=dict)  # that are expected of a frame, by step
    _ahead_s: float = 0.0  # that are expected of the frames to come
    _trust_s: float = 1.0  # measured seconds that weigh as much as what was expected
    _paced_s: float = 0.0  # that were expected of the frames whose time was measured, and what they took
    _measured_s: float = 0.0
    _last_s: float | None = None

    @property
    def run_time_s(self) -> float:
        """Time since the session began."""
        return max(1e-9, time.monotonic() - self.begun_s)

    def of(self, camera: str) -> CameraProgress:
        """Return that of a camera, by its name."""
        return self if camera == CAMERA else self.further.setdefault(camera, CameraProgress())

    def expect(self, steps: Sequence[Step], missing: Sequence[int], steps_s: Sequence[float]) -> None:
        """Learn what is to be done: for each step how many frames, and the seconds that are expected of it."""
        self.planned = sum(missing)
        self._frame_s = {step.index: each_s / step.frames for step, each_s in zip(steps, steps_s, strict=True)}
        self._ahead_s = sum(self._frame_s[step.index] * some for step, some in zip(steps, missing, strict=True))
        self._trust_s = max(LEAST_TRUST_S, TRUST * self._ahead_s)

    def took(self, frames: int, step: int) -> None:
        """Count frames of a step that have been taken; a negative number is to be taken again."""
        now_s, expected_s = time.monotonic(), frames * self._frame_s.get(step, 0.0)
        if self._last_s is not None:  # the first one waits for homing and compiling, which come once
            took_s = now_s - self._last_s
            if expected_s > 0.0:  # one that waited for a motor or a compiler is no measure of the others
                took_s = min(took_s, LEAP * self._pace * expected_s)
            self._measured_s += took_s
            self._paced_s += max(0.0, expected_s)
        self._last_s = now_s
        self._ahead_s -= expected_s
        self.frames += frames

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Do not take the time of this block, in which a person does something, for that of a frame."""
        begun_s = time.monotonic()
        try:
            yield
        finally:
            if self._last_s is not None:
                self._last_s += time.monotonic() - begun_s

    def time_left(self) -> str:
        """Time left as a person says it; "" before the first frame and behind the last.

        Expected seconds of what is left, times what frames have taken here for each second that was expected of
        them. That begins at 1 and follows the measured more and more, so that a single frame says little.
        """
        if not self.frames or self.planned <= self.frames:
            return ""
        return f"about {in_words(self._pace * max(0.0, self._ahead_s))} left"

    @property
    def _pace(self) -> float:
        """Seconds here for each that was expected."""
        return (self._measured_s + self._trust_s) / (self._paced_s + self._trust_s)


Watcher = Callable[[Progress], None]


DRAW_S = 0.25
LOG_S = 15.0
RECENT = 50


def account_sentence(progress: Progress) -> str:
    """Return the account of the frames; those that a run with a laser does not want are dark, or surplus."""
    found = progress.accounting
    if progress.laser is not None and found.rejected and not found.written:
        return f"waiting for light, {quantity(found.rejected, 'dark frame')} so far"
    return found.sentence().replace("rejected", "rejected" if progress.laser is None else "dark or surplus")


def panel(progress: Progress) -> Table:
    """Return the state of a run as a table."""
    latency = progress.stats.latency_ms[-RECENT:]
    raw, live = progress.waiting
    rows = [
        ("step", f"{progress.step + 1} of {progress.steps}  {progress.tag}"),
        ("doing", progress.doing),
        ("frames", f"{progress.frames} of {progress.planned}  ({progress.frames / progress.run_time_s:.1f} /s)"),
        ("time", progress.time_left() or "-"),
        ("waiting", f"{raw} to be written, {live} to be corrected"),
        ("latency", f"{np.median(latency):.0f} ms frame to corrected" if latency else "-"),
        ("skipped", f"{len(progress.stats.skipped)} not corrected live (done after the run)"),
        ("vectors", progress.stats.vectors.sentence() if progress.stats.vectors else "-"),
        ("positions", "  ".join(f"{name} {mm:.3f}" for name, mm in progress.positions_mm.items()) or "-"),
        ("account", account_sentence(progress)),
    ]
    if progress.readings:
        rows.append(("readings", "  ".join(f"{name} {shown}" for name, shown in progress.readings.items())))
    table = Table(show_header=False, box=None)
    for name, value in rows:
        table.add_row(Text(name, "bold"), value)
    return table


def line(progress: Progress) -> str:
    """Return the state of a run as one line of a log."""
    words = [
        f"step {progress.step + 1}/{progress.steps} {progress.tag}".rstrip(),
        progress.doing,
        progress.time_left(),
    ]
    if progress.stats.vectors is not None:
        words.append(f"vectors {progress.stats.vectors.sentence()}")
    return "; ".join([*filter(None, words), account_sentence(progress)])


@contextmanager
def watch(screen: Console) -> Iterator[Watcher]:
    """Yield a watcher that shows the progress on a terminal, or writes a line every `LOG_S` elsewhere."""
    last_s, said = time.monotonic(), 0

    def remark(progress: Progress) -> None:
        nonlocal said
        for sentence in progress.remarks[said:]:
            screen.print(sentence, soft_wrap=True, highlight=False, markup=False)
        said = len(progress.remarks)

    if not screen.is_terminal:

        def log(progress: Progress) -> None:
            nonlocal last_s
            remark(progress)
            if time.monotonic() - last_s >= LOG_S:
                last_s = time.monotonic()
                screen.print(line(progress), soft_wrap=True)

        yield log
        return
    with show_live(Live(console=screen, refresh_per_second=1.0 / DRAW_S, transient=True)) as live:

        def draw(progress: Progress) -> None:
            nonlocal last_s
            remark(progress)
            if time.monotonic() - last_s >= DRAW_S:
                last_s = time.monotonic()
                live.update(panel(progress))

        yield draw
