"""Physics of an axis: what motor, screw, carriage and switches do, whatever firmware commands them.

The motor driver makes pulses along a trapezoid of speed; it can be made to go, brake, or halt at any moment.
The rotor follows pulse by pulse, so it stands on whole steps. The screw turns rotor revolutions into nut
positions,

    nut = lead (1 + scale error) rev + amplitude sin(2 pi rev),

and the carriage hangs in the nut with play: it moves only while the nut pushes it (hysteresis operator "play").
Where the carriage cannot go on (an obstacle, the hard ends) the rotor is held and pulses are lost without
a report. A carriage may `slip` in its coupling, which no encoder on the motor sees, or its screw may be turned by
hand (`shove`), which an encoder counts and a step counter does not.

Time is continuous and events are found, not sampled: within a piece of constant acceleration the motion is
monotone, so the moment at which the carriage crosses the edge of a switch is found by bisection, the listener
is called at that moment, and what it commands takes effect from there.

Carriage positions grow with pulses; which way that is on the bench is the bench's business.  Nothing here knows mm
per step as a user would configure it; that is the business of firmware and driver, each
for itself.
"""

import math
import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

BISECTIONS = 50  # a double is exhausted before


@dataclass(frozen=True, slots=True)
class Mechanics:
    """Mechanics of one axis as it was built.

    Parameters
    ----------
    lead_mm : float
        Nominal travel per revolution.
    steps_per_rev : int
        Pulses per revolution.
    backlash_um : float
        Play between nut and carriage.
    lead_error_um : float
        Amplitude of the error that repeats every revolution.
    scale_error_ppm : float
        Relative error of the lead.
    low_switch_mm, high_switch_mm : float
        Carriage positions at and beyond which the switches are closed.
    index_mm : float
        Carriage position of the reference edge.
    run_out_mm : float
        Way from each switch to the hard end.
    power_up_mm : float
        Where the carriage stands when the world begins.
    """

    lead_mm: float = 4.0
    steps_per_rev: int = 12_800
    backlash_um: float = 0.0
    lead_error_um: float = 0.0
    scale_error_ppm: float = 0.0
    low_switch_mm: float = 0.0
    high_switch_mm: float = 150.0
    index_mm: float = 75.0
    run_out_mm: float = 2.0
    power_up_mm: float = 30.0

    def nut_mm(self, revolutions: float) -> float:
        """Position of the nut."""
        straight = self.lead_mm * (1.0 + self.scale_error_ppm * 1e-6) * revolutions
        return straight + self.lead_error_um * 1e-3 * math.sin(2.0 * math.pi * revolutions)


class Listener(Protocol):
    """Firmware, as the motor sees it."""

    def on_edge(self, name: str, upwards: bool) -> None:
        """The carriage crosses an edge: "low", "high", "index", or is "blocked"."""

    def on_rest(self) -> None:
        """The commanded motion has ended by itself."""


class Glide(NamedTuple):
    """A stretch of one motion, of constant acceleration: the true motion, for its watcher."""

    begin_s: float
    end_s: float
    begin_mm: float  # of the carriage
    end_mm: float
    begin_speed: float  # steps/s
    end_speed: float


class _Piece(NamedTuple):
    duration_s: float
    acceleration: float  # steps/s2


class Motor:
    """A motor with everything it carries.

    Parameters
    ----------
    mechanics : Mechanics
        What it drives.
    noise_steps : int
        A servo at rest hunts: what is read flickers by as much to each side.
    """

    def __init__(self, mechanics: Mechanics, noise_steps: int = 0) -> None:
        self.mechanics = mechanics
        self.listener: Listener | None = None
        self.watcher: Callable[[Glide], None] | None = None
        self.obstacle_mm: float | None = None
        self.is_jammed = False  # the carriage is stuck where it is
        self.noise_steps = noise_steps
        self._noise = random.Random(0)
        self.time_s = 0.0
        self._pulses = 0.0
        self._speed = 0.0
        self._target = 0.0
        self._plan: deque[_Piece] = deque()
        self._lost_steps = 0
        self._blocked = False
        self._start_rev = mechanics.power_up_mm / mechanics.lead_mm
        self._carriage_mm = mechanics.nut_mm(self._start_rev)

    # ---- what firmware may know ----------------------------------------------------------------

    @property
    def steps(self) -> int:
        """Pulses made so far, with sign."""
        return round(self._pulses)

    @property
    def encoder_steps(self) -> int:
        """Count of an encoder on the motor shaft."""
        return self.steps - self._lost_steps

    def flicker(self) -> int:
        """Steps by which what is read now differs from the count."""
        return self._noise.randint(-self.noise_steps, self.noise_steps) if self.noise_steps else 0

    @property
    def running(self) -> bool:
        """True while pulses are made."""
        return bool(self._plan)

    @property
    def target(self) -> float:
        """Count of pulses at which the present motion will end; infinite if a switch has to end it."""
        return self._target if self._plan else self._pulses

    def is_closed(self, switch: str) -> bool:
        """State of the switch "low" or "high", or of the reference edge "index" (closed at and above it)."""
        if switch == "low":
            return self._carriage_mm <= self.mechanics.low_switch_mm
        edge_mm = self.mechanics.high_switch_mm if switch == "high" else self.mechanics.index_mm
        return self._carriage_mm >= edge_mm

    # ---- the truth -----------------------------------------------------------------------------

    @property
    def carriage_mm(self) -> float:
        """True position of the carriage."""
        return self._carriage_mm

    # ---- what may happen to it -----------------------------------------------------------------

    def slip(self, distance_mm: float) -> None:
        """Let the carriage slip in its coupling, at most to the hard ends."""
        low_mm, high_mm = self._ends()
        distance_mm = min(max(distance_mm, low_mm - self._carriage_mm), high_mm - self._carriage_mm)
        before_mm = self._carriage_mm
        self._start_rev += distance_mm / self.mechanics.lead_mm
        self._carriage_mm += distance_mm
        self._report_jump(before_mm)

    def shove(self, steps: int) -> None:
        """Turn the screw by hand."""
        before_mm = self._carriage_mm
        self._lost_steps -= steps
        self._push(steps > 0)
        self._report_jump(before_mm)

    def _report_jump(self, before_mm: float) -> None:
        if self.watcher is not None:
            self.watcher(Glide(self.time_s, self.time_s, before_mm, self._carriage_mm, 0.0, 0.0))

    # ---- what firmware may do ------------------------------------------------------------------

    def go(self, target: float, speed: float, acceleration: float, at_s: float | None = None) -> None:
        """Make pulses until the count is `target` (may be infinite), starting from the present speed.

        `at_s` is the moment of the event that made firmware command it; it matters when a motor that rests is
        started by what another one does.
        """
        if at_s is not None and not self._plan:
            self.time_s = at_s
        self._target = target
        self._plan = deque(_trapezoid(target - self._pulses, self._speed, speed, acceleration))

    def brake(self, acceleration: float) -> None:
        """Slow down to rest."""
        if self._plan:
            duration_s = abs(self._speed) / acceleration
            self._target = self._pulses + self._speed * duration_s / 2.0
            self._plan = deque([_Piece(duration_s, -math.copysign(acceleration, self._speed))])

    def halt(self) -> None:
        """Make no more pulses, at once."""
        self._plan.clear()
        self._speed = 0.0
        self._pulses = float(round(self._pulses))

    def advance(self, time_s: float) -> None:
        """Let time pass; the listener hears what happens, in order."""
        if not self._plan:
            self.time_s = max(self.time_s, time_s)
            return
        while self._plan and self.time_s < time_s:
            piece = self._plan[0]
            end_s = min(piece.duration_s, time_s - self.time_s)
            event = self._first_event(piece, end_s)
            self._glide(piece, event[0] if event else end_s)
            if event:
                self._blocked = self._blocked or event[1] == "blocked"
                if self.listener:
                    self.listener.on_edge(event[1], event[2])
            elif not self._plan and self.listener:
                self.listener.on_rest()
        self.time_s = max(self.time_s, time_s)

    def _glide(self, piece: _Piece, duration_s: float) -> None:
        pulses, speed = _at(self._pulses, self._speed, piece.acceleration, duration_s)
        begin_s, begin_mm, begin_speed, end_speed = self.time_s, self._carriage_mm, self._speed, speed
        self.time_s += duration_s
        if duration_s >= piece.duration_s:
            self._plan.popleft()
            if not self._plan:
                pulses, speed = float(round(self._target)), 0.0
        else:
            self._plan[0] = _Piece(piece.duration_s - duration_s, piece.acceleration)
        up = pulses >= self._pulses
        self._pulses, self._speed = pulses, speed
        self._push(up)
        if self.watcher is not None:
            self.watcher(Glide(begin_s, self.time_s, begin_mm, self._carriage_mm, begin_speed, end_speed))

    def _push(self, pulses_up: bool) -> None:
        """Let rotor, nut and carriage follow the pulses, as far as they can."""
        carriage_mm = self._carriage_for(self.steps)
        low_mm, high_mm = self._ends()
        if low_mm <= carriage_mm <= high_mm:
            if carriage_mm != self._carriage_mm:
                self._blocked = False
            self._carriage_mm = carriage_mm
            return
        high_end = carriage_mm > high_mm
        self._carriage_mm = high_mm if high_end else low_mm
        back = -1 if pulses_up else 1  # the rotor falls back until the carriage only just touches the end

        def beyond(steps_back: int) -> bool:
            carriage_mm = self._carriage_for(self.steps + back * steps_back)
            return carriage_mm > high_mm if high_end else carriage_mm < low_mm

        reach = 1
        while beyond(reach):
            reach *= 2
        enough = reach
        while reach := reach // 2:
            if not beyond(enough - reach):
                enough -= reach
        self._lost_steps -= back * enough

    def _carriage_for(self, steps: float) -> float:
        """Carriage position if the pulse count went to `steps` in one direction from here."""
        mechanics = self.mechanics
        nut_mm = mechanics.nut_mm(self._start_rev + (round(steps) - self._lost_steps) / mechanics.steps_per_rev)
        half_mm = mechanics.backlash_um * 0.5e-3
        return min(max(self._carriage_mm, nut_mm - half_mm), nut_mm + half_mm)

    def _ends(self) -> tuple[float, float]:
        mechanics = self.mechanics
        if self.is_jammed:
            return self._carriage_mm, self._carriage_mm
        low_mm, high_mm = (
            mechanics.low_switch_mm - mechanics.run_out_mm,
            mechanics.high_switch_mm + mechanics.run_out_mm,
        )
        if self.obstacle_mm is not None:
            if self.obstacle_mm >= self._carriage_mm:
                high_mm = min(high_mm, self.obstacle_mm)
            else:
                low_mm = max(low_mm, self.obstacle_mm)
        return low_mm, high_mm

    def _edges(self) -> list[tuple[str, float]]:
        mechanics = self.mechanics
        edges = [
            ("low", math.nextafter(mechanics.low_switch_mm, math.inf)),  # closed at the edge itself
            ("high", mechanics.high_switch_mm),
            ("index", mechanics.index_mm),
        ]
        if not self._blocked:
            low_mm, high_mm = self._ends()
            edges += [("blocked", math.nextafter(high_mm, math.inf)), ("blocked", low_mm)]
        return edges

    def _free(self, low_mm: float, high_mm: float) -> bool:
        """Return whether there is plainly no edge on this way; most ways are so, and short."""
        mechanics = self.mechanics
        return (
            self.obstacle_mm is None
            and not self.is_jammed
            and mechanics.low_switch_mm < low_mm
            and high_mm < mechanics.high_switch_mm
            and not low_mm < mechanics.index_mm <= high_mm
        )

    def _first_event(self, piece: _Piece, end_s: float) -> tuple[float, str, bool] | None:
        """Earliest edge crossed within a piece: time from now, name, direction."""
        here_mm = self._carriage_mm

        def carriage_mm(after_s: float) -> float:
            return self._carriage_for(_at(self._pulses, self._speed, piece.acceleration, after_s)[0])

        there_mm, first = carriage_mm(end_s), None
        low_mm, high_mm = min(here_mm, there_mm), max(here_mm, there_mm)
        if self._free(low_mm, high_mm):
            return None
        for name, edge_mm in self._edges():
            if not low_mm < edge_mm <= high_mm:
                continue
            before_s, after_s = 0.0, end_s
            for _ in range(BISECTIONS):
                middle_s = 0.5 * (before_s + after_s)
                if (carriage_mm(middle_s) >= edge_mm) == (here_mm >= edge_mm):
                    before_s = middle_s
                else:
                    after_s = middle_s
            if first is None or after_s < first[0]:
                first = (after_s, name, there_mm > here_mm)
        return first


def _at(pulses: float, speed: float, acceleration: float, after_s: float) -> tuple[float, float]:
    return pulses + speed * after_s + 0.5 * acceleration * after_s**2, speed + acceleration * after_s


def _trapezoid(distance: float, speed: float, top_speed: float, acceleration: float) -> list[_Piece]:
    """Pieces of constant acceleration that end at rest after `distance`, beginning at `speed`."""
    pieces: list[_Piece] = []
    stopping = speed * abs(speed) / (2.0 * acceleration)
    if speed and (
        speed * distance <= 0.0 or abs(stopping) > abs(distance)
    ):  # wrong way, or too fast to stop there
        pieces.append(_Piece(abs(speed) / acceleration, -math.copysign(acceleration, speed)))
        distance, speed = distance - stopping, 0.0
    if distance == 0.0:
        return pieces
    sense = math.copysign(1.0, distance)
    begin, way = abs(speed), abs(distance)
    peak = min(top_speed, math.sqrt(acceleration * way + 0.5 * begin**2)) if math.isfinite(way) else top_speed
    change = acceleration if peak >= begin else -acceleration
    pieces.append(_Piece(abs(peak - begin) / acceleration, sense * change))
    used = abs(peak**2 - begin**2) / (2.0 * acceleration) + peak**2 / (2.0 * acceleration)
    if way - used > 0.0:
        pieces.append(_Piece((way - used) / peak, 0.0))
    pieces.append(_Piece(peak / acceleration, -sense * acceleration))
    return [piece for piece in pieces if piece.duration_s > 0.0]
