"""The independent judge: where everything truly is, whether it may be there, whether it may move now.

A witness hangs on the motors, not on what controllers say. Each stretch of each motion is noted as it happens
(`sim.mechanics.motion.Glide`) and judged later, when all motors have come up to the same moment; it raises
nothing into the world and keeps a list of `Violation`. Four things are violations:

========  ==========================================================================================
limit     an axis is truly outside its limits of the bench file
keep-out  camera, glass and target are truly closer than the bench file allows (`sim.witness.clearances`)
stop      a motor drives on, or begins to, more than `STOP_S` after a stop and before it is cleared
told      a position was reported as known and is not where the axis truly is
========  ==========================================================================================

**What is allowed.** Reference runs, which look for what is not known yet (the firmware says which motor is in
one), and what a person turns by hand: neither limits nor keep-out are asked of them, as docs/safety.md says;
stops are asked of reference runs, and their braking way is theirs. What begins outside a limit or closer than
allowed may go away from there, and not further in. A motor that slows down does what it can: after a stop only
speed that does not fall is a violation, so the way of braking needs no number. What a stop cannot reach (a port
that is closed or gone, or goes within `STOP_S`) may end its motion.

**What is tolerated** is what the workshop built: `SLACK_MM` for the reference edge, whole steps
and tolerances of arrival, the play, the lead error twice, the error of the scale over the whole travel. A
carriage that has slipped unnoticed (`note_slip`) adds its way until its axis is homed again.

It costs about 5 us a glide (one or two a poll of a moving axis): a tenth of the time of tests that do nothing
but move stages, nothing of all others.
"""

import math
import os
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

from sim.emulators.device import Clock, Purpose
from sim.emulators.line import Line
from sim.mechanics.motion import Glide, Motor
from sim.witness.clearances import Carried, Clearances
from stages.config import StagesTable

if TYPE_CHECKING:  # names alone: a watcher without a scene does not wait for scipy and numba
    from daq.bench.keep_out import KeepOutTable
    from tracer.scene.scene import Scene

SLACK_MM = 0.05
STOP_S = 0.1
RAMP_S = 0.01  # several motors that change speed at once are looked at in stretches as short as this
GOES_ON_S = 1.0  # a violation seen again within this time is the same one
NOISE_MM = 1e-6
KEPT_GLIDES = 500  # judged at the latest when so many wait
LEDGER = "RTPIV_WITNESS"  # environment: a folder in which every process writes the violations that it sees
DIRECTIONS: dict[str, Literal[0, 1, 2]] = {"x": 0, "y": 1, "z": 2}

Kind = Literal["limit", "keep-out", "stop", "told"]


class Violation(NamedTuple):
    """Something that must never happen has happened."""

    kind: Kind
    what: str
    time_s: float
    depth_mm: float
    text: str

    def __str__(self) -> str:
        return f"{self.kind} of {self.what} at {self.time_s:.3f} s by {self.depth_mm:.3f} mm: {self.text}"


@dataclass
class Watched:
    """An axis and how it was built.

    Parameters
    ----------
    motor : Motor
        What moves it.
    line : Line
        What its controller hangs on.
    channel : str
        Its name there.
    sign, zero_mm, offset_mm : int, float, float
        axis = sign (carriage - zero) + offset.
    limits_mm : (float, float)
        From the bench file.
    slack_mm : float
        What is tolerated.
    """

    motor: Motor
    line: Line
    channel: str
    sign: int
    zero_mm: float
    offset_mm: float
    limits_mm: tuple[float, float]
    slack_mm: float
    at_mm: float = 0.0  # up to where it has been judged
    slipped_mm: float = 0.0
    depth_mm: float = 0.0  # outside its limits when its motion began
    free_until_s: float = -math.inf  # end of what was not judged

    def axis_mm(self, carriage_mm: float) -> float:
        """Coordinate of the bench file."""
        return self.sign * (carriage_mm - self.zero_mm) + self.offset_mm

    def outside_mm(self, at_mm: float) -> float:
        """Distance of a position outside the limits, 0 within."""
        return max(self.limits_mm[0] - at_mm, at_mm - self.limits_mm[1], 0.0)


class _Noted(NamedTuple):
    """A glide of one axis, in the coordinate of the bench file."""

    begin_s: float
    end_s: float
    axis: str
    begin_mm: float
    end_mm: float
    begin_speed: float
    end_speed: float
    purpose: Purpose

    def at_mm(self, time_s: float) -> float:
        """Position at a moment within it."""
        whole_s = self.end_s - self.begin_s
        whole = 0.5 * (self.begin_speed + self.end_speed) * whole_s
        if whole_s <= 0.0 or whole == 0.0:
            return self.end_mm
        past_s = min(max(time_s - self.begin_s, 0.0), whole_s)
        part = self.begin_speed * past_s + 0.5 * (self.end_speed - self.begin_speed) * past_s**2 / whole_s
        return self.begin_mm + part / whole * (self.end_mm - self.begin_mm)

    @property
    def brakes(self) -> bool:
        """Return whether its speed falls."""
        return abs(self.end_speed) < abs(self.begin_speed)


@dataclass
class _Stop:
    """A stop, and what it could not reach."""

    begin_s: float
    out_of_reach: dict[int, float]  # lines, and until when what moved there has gone on without a rest
    only: int | None = None  # the line that it is about; None: all
    end_s: float = field(default=math.inf)


class Witness:
    """Watches the axes of one simulated bench.

    Parameters
    ----------
    axes : mapping of str to Watched
        By name.
    clock : Clock
        Time of the world.
    """

    def __init__(self, axes: Mapping[str, Watched], clock: Clock) -> None:
        self.axes = dict(axes)
        self.violations: list[Violation] = []
        self._ongoing: dict[tuple[Kind, str], tuple[int, float]] = {}  # place in the list, last seen when
        self.judged = 0  # glides so far
        self.clock = clock
        self._noted: deque[_Noted] = deque()
        self._judging = threading.Lock()
        self._clearances: Clearances | None = None
        self._stops: list[_Stop] = []
        self._rest_s = -math.inf  # since when nothing moves, as far as it has been judged
        self._lines = {id(watched.line): watched.line for watched in self.axes.values()}
        for line in self._lines.values():
            line.on_cut = partial(self._cut, line)
        for name, watched in self.axes.items():
            watched.at_mm = watched.axis_mm(watched.motor.carriage_mm)
            watched.motor.watcher = self._ear(name, watched)

    def look_at(
        self, scene: "Scene", table: "KeepOutTable", stages: StagesTable, home_mm: Mapping[str, float]
    ) -> None:
        """Judge clearances too, in a scene that holds where every axis stands at `home_mm`."""
        carried = {
            name: Carried(axis.carries, DIRECTIONS[axis.along], home_mm[name])
            for name, axis in stages.axes.items()
        }
        slack_mm = {name: watched.slack_mm for name, watched in self.axes.items()}
        self._clearances = Clearances(scene, carried, table, slack_mm)
        for name, watched in self.axes.items():
            self._clearances.put(name, watched.at_mm)

    # ---- what is reported to it-------------------------------------------------------------------

    def note_stop(self, at_s: float | None = None, only: Line | None = None) -> None:
        """Note a stop of the bench, or what hangs on one line."""
        at_s = self.clock.now_s() if at_s is None else at_s
        self._bring_up()
        out_of_reach = {
            id(axis.line): at_s for axis in self.axes.values() if axis.motor.running and not axis.line.is_reached
        }
        self._stops.append(_Stop(at_s, out_of_reach, None if only is None else id(only)))

    def _cut(self, line: Line) -> None:
        """A plug is pulled; a stop of this moment may not have come through."""
        now_s = self.clock.now_s()
        for stop in self._stops:
            if now_s - stop.begin_s <= STOP_S:
                stop.out_of_reach[id(line)] = now_s

    def note_clear(self, only: Line | None = None) -> None:
        """Note that the stop is cleared, or that of one line alone: things may move again."""
        for stop in self._stops:
            if only is None or stop.only == id(only):
                stop.end_s = min(stop.end_s, self.clock.now_s())

    def note_slip(self, axis: str, distance_mm: float) -> None:
        """Note that a carriage slips unnoticed now; forgiven until its axis is homed."""
        self.judge()  # an older reference run forgives nothing
        self.axes[axis].slipped_mm += abs(distance_mm)

    def check_report(self, axis: str, position_mm: float) -> None:
        """Check a position of an axis that was reported as known now."""
        watched = self.axes[axis]
        with watched.line.lock:
            watched.line.emulator.advance()
            true_mm = watched.axis_mm(watched.motor.carriage_mm)
        allowed_mm = watched.slack_mm + watched.slipped_mm
        if abs(position_mm - true_mm) > allowed_mm:
            text = f"{position_mm:.3f} mm was reported, it is at {true_mm:.3f} mm"
            self._add("told", axis, self.clock.now_s(), abs(position_mm - true_mm) - allowed_mm, text)

    # ---- what it sees --------------------------------------------------------------------------

    def _ear(self, name: str, watched: Watched) -> Callable[[Glide], None]:
        sign, shift_mm = watched.sign, watched.offset_mm - watched.sign * watched.zero_mm
        emulator, channel, note = watched.line.emulator, watched.channel, self._noted.append

        def hear(glide: Glide) -> None:
            begin_s, end_s, begin_mm, end_mm, begin_speed, end_speed = glide
            note(
                _Noted(
                    begin_s, end_s, name, sign * begin_mm + shift_mm, sign * end_mm + shift_mm,
                    begin_speed, end_speed, emulator.purpose(channel),
                )
            )  # fmt: skip

        return hear

    def judge_if_much(self) -> None:
        """Judge when much has been noted; to be called without any lock of a line."""
        if len(self._noted) > KEPT_GLIDES:
            self.judge(waits=False)

    def judge(self, waits: bool = True) -> list[Violation]:
        """Bring all motors up to now, judge everything noted so far, return all violations there are."""
        if self._judging.acquire(blocking=waits):
            try:
                now_s = self.clock.now_s()
                self._bring_up()
                noted = [self._noted.popleft() for _ in range(len(self._noted))]
                self._judge([glide for glide in noted if glide.end_s <= now_s])
                self._noted.extendleft(reversed([glide for glide in noted if glide.end_s > now_s]))
            finally:
                self._judging.release()
        return self.violations

    def _bring_up(self) -> None:
        """Let every motor come up to now."""
        for line in self._lines.values():
            with line.lock:
                line.emulator.advance()

    def _judge(self, glides: list[_Noted]) -> None:
        glides.sort()
        self.judged += len(glides)
        together: list[_Noted] = []
        for glide in glides:
            if glide.begin_s >= self._rest_s:  # nothing that moved before moves any more
                self._judge_together(together)
                together = []
                if glide.begin_s > self._rest_s:
                    self._at_rest()
            if glide.begin_s == glide.end_s:
                self._put(glide)
                continue
            together.append(glide)
            self._rest_s = max(self._rest_s, glide.end_s)
        self._judge_together(together)

    def _at_rest(self) -> None:
        for watched in self.axes.values():
            watched.depth_mm = watched.outside_mm(watched.at_mm)
        if self._clearances is not None:
            self._clearances.note_rest()

    def _put(self, glide: _Noted) -> None:
        """Note a change of no duration: a carriage has slipped, a screw was turned."""
        self.axes[glide.axis].at_mm = glide.end_mm
        if self._clearances is not None:
            self._clearances.put(glide.axis, glide.end_mm)

    def _judge_together(self, glides: Sequence[_Noted]) -> None:
        """Judge glides that overlap in time; often there is only one."""
        for glide in glides:
            self._judge_stop(glide)
        if len({glide.axis for glide in glides}) <= 1:
            for glide in glides:
                self._stretch([glide], glide.end_s)
            return
        for begin_s, end_s in _stretches(glides):
            self._stretch([one for one in glides if one.begin_s < end_s and one.end_s > begin_s], end_s)

    def _stretch(self, running: Sequence[_Noted], end_s: float) -> None:
        """Judge a stretch of time, from where everything has been judged."""
        ends_mm: dict[str, float] = {}
        held: set[str] = set()
        for glide in running:
            watched = self.axes[glide.axis]
            watched.at_mm = ends_mm[glide.axis] = glide.at_mm(end_s) if glide.end_s > end_s else glide.end_mm
            ends_freely = glide.brakes and glide.begin_s <= watched.free_until_s
            if glide.purpose == "move" and not ends_freely:
                held.add(glide.axis)
                self._judge_limits(glide.axis, watched, end_s)
            else:
                watched.depth_mm, watched.free_until_s = watched.outside_mm(watched.at_mm), glide.end_s
                watched.slipped_mm *= glide.purpose != "reference"
        if self._clearances is not None:
            slipped_mm = {name: axis.slipped_mm for name, axis in self.axes.items() if axis.slipped_mm}
            for one, other, clearance_mm, allowed_mm in self._clearances.judge_motion(ends_mm, held, slipped_mm):
                moved = ", ".join(sorted(held))
                text = f"{clearance_mm:.3f} mm apart, {allowed_mm:.3f} mm are allowed, by moving {moved}"
                self._add("keep-out", f"{one} and {other}", end_s, allowed_mm - clearance_mm, text)

    def _judge_limits(self, name: str, watched: Watched, time_s: float) -> None:
        allowed_mm = max(watched.depth_mm + NOISE_MM, watched.slack_mm + watched.slipped_mm)
        outside_mm = watched.outside_mm(watched.at_mm)
        if outside_mm > allowed_mm:
            low, high = watched.limits_mm
            text = f"truly at {watched.at_mm:.3f} mm, limits {low:g} to {high:g} mm"
            self._add("limit", name, time_s, outside_mm - allowed_mm, text)

    def _judge_stop(self, glide: _Noted) -> None:
        if glide.purpose == "hand":
            return
        line = id(self.axes[glide.axis].line)
        for stop in self._stops:
            late_s = stop.begin_s + STOP_S
            if stop.only not in (None, line):
                continue
            if glide.begin_s <= stop.out_of_reach.get(line, -math.inf):
                stop.out_of_reach[line] = max(stop.out_of_reach[line], glide.end_s)
                continue
            if glide.end_s <= late_s or glide.begin_s >= stop.end_s:
                continue
            driven_mm = abs(glide.end_mm - glide.at_mm(max(late_s, glide.begin_s)))
            if not glide.brakes and driven_mm > NOISE_MM:
                text = f"it drives {glide.end_s - stop.begin_s:.3f} s after a stop"
                self._add("stop", glide.axis, glide.end_s, driven_mm, text)

    def _add(self, kind: Kind, what: str, time_s: float, depth_mm: float, text: str) -> None:
        """Keep a violation; one that goes on stays the same, and keeps how deep it goes."""
        violation = Violation(kind, what, time_s, depth_mm, text)
        ongoing = self._ongoing.get((kind, what))
        if ongoing is not None and time_s - ongoing[1] < GOES_ON_S:
            self._ongoing[kind, what] = ongoing[0], time_s
            first = self.violations[ongoing[0]]
            if depth_mm > first.depth_mm:
                self.violations[ongoing[0]] = first._replace(depth_mm=depth_mm, text=text)
            return
        self._ongoing[kind, what] = len(self.violations), time_s
        self.violations.append(violation)
        if ledger := os.environ.get(LEDGER):
            Path(ledger).mkdir(exist_ok=True)
            with (Path(ledger) / f"{os.getpid()}.txt").open("a", encoding="utf-8") as file:
                file.write(f"{violation}\n")


def _stretches(glides: Sequence[_Noted]) -> Iterator[tuple[float, float]]:
    """Intervals between the moments at which something begins or ends, none longer than RAMP_S."""
    moments = sorted({moment for glide in glides for moment in (glide.begin_s, glide.end_s)})
    for begin_s, end_s in pairwise(moments):
        count = int((end_s - begin_s) / RAMP_S) + 1
        for index in range(count):
            yield begin_s + (end_s - begin_s) * index / count, begin_s + (end_s - begin_s) * (index + 1) / count
