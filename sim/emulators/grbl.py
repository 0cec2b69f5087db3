"""A Grbl 1.1 board with up to three motors.

Real-time bytes act at once; lines are obeyed in order, a little after they have come: the main loop has to read
them. So a jog cancel (0x85) that comes right behind a ``$J`` line finds no jog and does nothing. ``ok`` to a
motion means queued; a dwell (G4) and everything after it wait for the queue. While homing, and in the alarm of a
hard limit, no report is given; after that alarm only a reset is heard, and one that comes before ``[MSG:Reset to
continue]`` is thrown away.

A feed hold (``!``, or the button on the box) ends a jog short of its target and keeps the position; at rest and
in other motions it holds: no line is read any more until ``~`` or a reset, and those that wait are obeyed then.

Power-up and every reset forget what the parser knew (tool, feed); power-up forgets the position as well, and a
board with homing switched on is then locked.

Homing seeks the switch, leaves it, finds it again slowly and stops ``$27`` away from it; the direction is set by
``$23``. A switch that is still closed then ends homing with ALARM:8. Machine coordinates then run from -travel
to 0. Nothing watches the rotors.
"""

import re
from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple

from sim.emulators.device import Clock, Emulator, Purpose
from sim.mechanics.motion import Motor
from stages.errors import ProtocolViolation
from stages.protocols import grbl

NAMES = ("X", "Y", "Z")
MESSAGE_DELAY_S = 0.05
READING_S = 0.0008  # from the end of a line to the beginning of what it asks for
LARGEST_TOOL = 255
NOT_CLEARED = 8  # alarm: the switch is still closed after the way that should have opened it
VERSION = "1.1h"

_WORD = re.compile(r"([A-Z])(-?\d*\.?\d+)")


class _Motion(NamedTuple):
    """A line of the planner's queue."""

    targets_mm: dict[str, float]
    speed_mm_s: float


class GrblEmulator(Emulator):
    """One board.

    Parameters
    ----------
    motors : mapping of str to Motor
        X, Y, Z.
    settings : mapping of int to float
        Settings ($n) other than the board's defaults.
    boot_s : float
        Time that the boot loader takes from now on; nothing is heard meanwhile, and a banner ends it.
    restart_s : float
        Time that the boot loader takes after power has failed.
    user_string : str
        What its owner wrote with ``$I=``; empty on a new board.
    """

    decoder = grbl.CommandStream
    zero_at_top = True

    def __init__(
        self,
        motors: Mapping[str, Motor],
        clock: Clock,
        settings: Mapping[int, float] | None = None,
        boot_s: float = 0.0,
        restart_s: float = 0.0,
        user_string: str = "",
    ) -> None:
        super().__init__(motors, clock)
        self._restart_s, self._user_string = restart_s, user_string
        self._lines: deque[tuple[float, str]] = deque()  # when each will be read
        self.settings: dict[int, float] = {
            0: 10, 1: 255, 2: 0, 3: 0, 4: 0, 5: 0, 6: 0, 10: 1, 11: 0.01, 12: 0.002, 13: 0, 20: 1, 21: 1, 22: 1,
            23: 7, 24: 25.0, 25: 1500.0, 26: 250, 27: 1.0, 30: 1000, 31: 0, 32: 0,
        }  # fmt: skip
        for index, name in enumerate(NAMES):
            screw = self.motors[name].mechanics if name in self.motors else None
            self.settings[100 + index] = screw.steps_per_rev / screw.lead_mm if screw else 250.0
            self.settings[110 + index] = 3000.0
            self.settings[120 + index] = 100.0
            self.settings[130 + index] = screw.high_switch_mm - screw.low_switch_mm if screw else 200.0
        self.settings.update(settings or {})
        self._queue: deque[_Motion] = deque()
        self._homing: deque[str] = deque()
        self._boots_until_s: float | None = None
        self._forget()
        if boot_s:
            self._boot(boot_s)
        for name, motor in self.motors.items():
            motor.listener = self.hear(name)

    @classmethod
    def individual(cls, name: str) -> dict[str, Any]:
        """Options that distinguish this box from another of its kind."""
        return {"user_string": name}

    # ---- power and buttons ---------------------------------------------------------------------

    def button(self, code: int = grbl.HOLD) -> None:
        """Press a button on the box: feed hold, resume or reset, as their real-time bytes."""
        self.advance()
        self._real_time(code)

    @property
    def is_held(self) -> bool:
        """Return whether a feed hold stands that only a person, or a reset, ends."""
        return self._state == "Hold"

    def person_stops(self) -> None:
        """The button for feed hold."""
        self.button()

    def purpose(self, channel: str) -> Purpose:
        """Homing, of whatever axis, or a motion."""
        return "reference" if self._state == "Home" else "move"

    def _power_up(self) -> None:
        self._forget()
        if self._restart_s:
            self._boot(self._restart_s)
        else:
            self._greet()

    def _boot(self, duration_s: float) -> None:
        self._boots_until_s = self.event_s + duration_s
        self.act_at(self._boots_until_s)

    def _forget(self) -> None:
        self._zero = {name: motor.steps for name, motor in self.motors.items()}
        self._state = "Alarm" if self.settings[22] else "Idle"
        self._mute = False  # in the alarm of a hard limit
        self._message_s: float | None = None
        self._phase = ""
        self._boots_until_s = None
        self._forget_work()

    def _forget_work(self) -> None:
        """Clear what every reset clears: waiting lines, motions, the parser's modes."""
        self._lines.clear()
        self._queue.clear()
        self._homing.clear()
        self._under_way: _Motion | None = None
        self._substate = 0  # of Hold: 1 while slowing down
        self._hold_later = False  # a feed hold that came while homing
        self._tool, self._feed = 0, 0.0

    # ---- input ---------------------------------------------------------------------------------

    def _take(self, data: bytes) -> None:
        if self._boots_until_s is None:
            super()._take(data)

    def _hear(self, command: grbl.Line | grbl.RealTime | ProtocolViolation) -> None:
        if isinstance(command, grbl.RealTime):
            self._real_time(command.code)
        elif self._mute:
            return
        elif isinstance(command, ProtocolViolation):
            self.say(grbl.Refusal(11).to_bytes())
        else:
            self._lines.append((self.event_s + READING_S, command.text.upper().replace(" ", "")))
            self.act_at(self.event_s + READING_S)

    def _tick(self, now_s: float) -> None:
        if self._boots_until_s is not None and now_s >= self._boots_until_s:
            self._boots_until_s = None
            self._greet()
        if self._message_s is not None and now_s >= self._message_s:
            self.say(grbl.Feedback("MSG", "Reset to continue").to_bytes(), self._message_s)
            self._message_s = None
        self._work()

    def _work(self) -> None:
        """Obey waiting lines until one has to wait."""
        while self._lines and self._state not in ("Home", "Hold") and not self._mute:
            due_s, line = self._lines[0]
            if due_s > self.event_s or (line.startswith("G4") and self._state in ("Run", "Jog")):
                return
            self._lines.popleft()
            if line.startswith(("$H", "$$", "$I")) and self._state in ("Run", "Jog"):
                self.say(grbl.Refusal(8).to_bytes())
            else:
                self._obey(line)

    def _real_time(self, code: int) -> None:
        if code == grbl.STATUS:
            if not self._mute and self._state != "Home":
                self.say(self._report().to_bytes())
        elif code == grbl.RESET:
            self._reset()
        elif self._state == "Jog" and code in (grbl.JOG_CANCEL, grbl.HOLD):
            self._queue.clear()
            self._brake()
        elif code == grbl.HOLD:
            self._hold()
        elif code == grbl.RESUME and self._state == "Hold" and not self._substate:
            self._resume()

    def _brake(self) -> None:
        for index, name in enumerate(NAMES):
            if name in self.motors:
                self.motors[name].brake(self.settings[120 + index] * self.settings[100 + index])

    def _hold(self) -> None:
        if self._state == "Home":
            self._hold_later = True
        elif self._state == "Idle":
            self._state, self._substate = "Hold", 0
        elif self._state == "Run":
            self._state, self._substate = "Hold", 1
            self._brake()

    def _resume(self) -> None:
        """Go on with the motion that was held, or with nothing."""
        self._state = "Run"
        if self._under_way is not None:
            self._queue.appendleft(self._under_way)
        self._start_next()
        self._work()

    def _report(self) -> grbl.Status:
        place = tuple(self._place_mm(name) + self._noise_mm(name) for name in NAMES)
        substate = self._substate if self._state == "Hold" else None
        return grbl.Status(self._state, place, substate=substate, extras=(("FS", "0,0"),))

    def _noise_mm(self, name: str) -> float:
        return self.motors[name].flicker() / self.settings[100 + NAMES.index(name)] if name in self.motors else 0.0

    def _place_mm(self, name: str) -> float:
        if name not in self.motors:
            return 0.0
        return (self.motors[name].steps - self._zero[name]) / self.settings[100 + NAMES.index(name)]

    def _reset(self) -> None:
        if self._mute and self._message_s is not None:
            return  # thrown away
        moving = any(motor.running for motor in self.motors.values())
        for motor in self.motors.values():
            motor.halt()
        if self._state == "Home" or moving:
            self.say(grbl.Alarm(6 if self._state == "Home" else 3).to_bytes())
            self._state = "Alarm"
        elif self._state in ("Hold", "Jog", "Run"):
            self._state = "Idle"
        self._forget_work()
        self._mute = False
        self._greet()

    def _greet(self) -> None:
        self.say(grbl.Banner(VERSION).to_bytes())
        if self._state == "Alarm":
            self.say(grbl.Feedback("MSG", "'$H'|'$X' to unlock").to_bytes())

    # ---- lines ---------------------------------------------------------------------------------

    def _obey(self, line: str) -> None:
        answer: grbl.Ok | grbl.Refusal | None = grbl.Ok()
        if line == "$I":
            self.say(grbl.Feedback("VER", f"{VERSION}.20190830:{self._user_string}").to_bytes())
            self.say(grbl.Feedback("OPT", "V,15,128").to_bytes())
        elif line == "$$":
            for number, value in sorted(self.settings.items()):
                whole = number < 100 and number not in (11, 12, 24, 25, 27)
                text = f"{value:.0f}" if whole else f"{value:.3f}"
                self.say(grbl.Setting(number, text).to_bytes())
        elif line == "$G":
            modes = f"G0 G54 G17 G21 G90 G94 M5 M9 T{self._tool} F{self._feed:g} S0"
            self.say(grbl.Feedback("GC", modes).to_bytes())
        elif line == "$X":
            self._state = "Idle" if self._state == "Alarm" else self._state
            self.say(grbl.Feedback("MSG", "Caution: Unlocked").to_bytes())
        elif line == "$H":
            answer = self._home()
        elif match := re.fullmatch(r"\$(\d+)=(-?\d+\.?\d*)", line):
            answer = self._set(int(match[1]), float(match[2]))
        elif line.startswith("$J="):
            answer = self._motion(line[3:], jog=True)
        elif line.startswith("$"):
            answer = grbl.Refusal(3)
        elif self._state in ("Alarm", "Jog"):
            answer = grbl.Refusal(9)
        elif match := re.fullmatch(r"T(\d+)", line):
            answer = self._choose(int(match[1]))
        elif not line.startswith("G4"):
            answer = self._motion(line, jog=False)
        if answer is not None:
            self.say(answer.to_bytes())

    def _set(self, number: int, value: float) -> grbl.Ok | grbl.Refusal:
        if number not in self.settings:
            return grbl.Refusal(3)
        if number == 20 and value and not self.settings[22]:
            return grbl.Refusal(10)
        self.settings[number] = value
        return grbl.Ok()

    def _choose(self, tool: int) -> grbl.Ok | grbl.Refusal:
        if tool > LARGEST_TOOL:
            return grbl.Refusal(38)
        self._tool = tool
        return grbl.Ok()

    def _motion(self, text: str, jog: bool) -> grbl.Ok | grbl.Refusal | None:
        if self._state == "Alarm":
            return grbl.Refusal(9)
        words = _WORD.findall(text)
        if "".join(letter + number for letter, number in words) != text:
            return grbl.Refusal(2)
        modes = {float(number) for letter, number in words if letter == "G"}
        feed = next((float(number) for letter, number in words if letter == "F"), 0.0)
        inch = 25.4 if 20.0 in modes else 1.0
        if feed <= 0.0 and not (0.0 in modes and not jog):
            return grbl.Refusal(22)
        targets = {}
        for letter, number in words:
            if letter in self.motors:
                base = self._end_mm(letter) if 91.0 in modes else 0.0
                targets[letter] = base + float(number) * inch
        if not targets:
            return grbl.Refusal(16 if jog else 26)
        for name, target_mm in targets.items():
            travel_mm = self.settings[130 + NAMES.index(name)]
            if self.settings[20] and not -travel_mm <= target_mm <= 0.0:
                if jog:
                    return grbl.Refusal(15)
                self._alarm(2)  # the line itself is never answered
                return None
        if not jog and feed:
            self._feed = feed * inch
        self._queue.append(_Motion(targets, feed * inch / 60.0 if feed else 1e9))
        if self._state == "Idle":
            self._state = "Jog" if jog else "Run"
            self._start_next()
        return grbl.Ok()

    def _end_mm(self, name: str) -> float:
        """Position of a motor after everything queued."""
        under_way = [] if self._under_way is None else [self._under_way]
        for motion in [*reversed(self._queue), *under_way]:
            if name in motion.targets_mm:
                return motion.targets_mm[name]
        return self._place_mm(name)

    def _start_next(self) -> None:
        while self._queue:
            targets, speed_mm_s = self._under_way = self._queue.popleft()
            way_mm = {name: abs(target - self._place_mm(name)) for name, target in targets.items()}
            longest_mm = max(way_mm.values())
            started = False
            for name, target_mm in targets.items():
                index = NAMES.index(name)
                scale = self.settings[100 + index]
                steps = round(target_mm * scale) + self._zero[name]
                if steps != self.motors[name].steps:
                    share = way_mm[name] / longest_mm
                    top = min(speed_mm_s, self.settings[110 + index] / 60.0) * scale * share
                    self.motors[name].go(
                        steps, max(top, 1.0), self.settings[120 + index] * scale * max(share, 1e-3)
                    )
                    started = True
            if started:
                return
        self._under_way = None
        self._state = "Idle"

    # ---- events --------------------------------------------------------------------------------

    def rest(self, axis: str) -> None:
        """A motor has come to rest by itself."""
        if self._state == "Home":
            self._homing_rest(axis)
        elif not any(motor.running for motor in self.motors.values()):
            if self._state in ("Run", "Jog"):
                self._start_next()
            elif self._state == "Hold":
                self._substate = 0

    def edge(self, axis: str, name: str, upwards: bool) -> None:
        """A motor's carriage crosses an edge."""
        if name not in ("low", "high"):
            return
        closing = upwards == (name == "high")
        if self._state == "Home":
            if closing and self._phase in ("seek", "locate"):
                self.motors[axis].halt()
                self._pull_off(axis)
        elif closing and self.settings[21]:
            for motor in self.motors.values():
                motor.halt()
            self._alarm(1)

    def _alarm(self, code: int) -> None:
        self._state, self._mute, self._message_s = "Alarm", True, self.event_s + MESSAGE_DELAY_S
        self.act_at(self._message_s)
        self._queue.clear()
        self._lines.clear()
        self.say(grbl.Alarm(code).to_bytes())

    # ---- homing --------------------------------------------------------------------------------

    def _home(self) -> grbl.Refusal | None:
        if not self.settings[22]:
            return grbl.Refusal(5)
        self._state = "Home"
        self._homing = deque(reversed([name for name in NAMES if name in self.motors]))
        self._home_next()
        return None

    def _home_next(self) -> None:
        if not self._homing:
            self._state = "Hold" if self._hold_later else "Idle"
            self._hold_later = False
            self.say(grbl.Ok().to_bytes())
            self._work()
            return
        self._phase = "seek"
        self._towards(self._homing[0], self.settings[25])

    def _downwards(self, axis: str) -> bool:
        return bool(int(self.settings[23]) >> NAMES.index(axis) & 1)

    def _towards(self, axis: str, rate_mm_min: float) -> None:
        index, motor = NAMES.index(axis), self.motors[axis]
        if motor.is_closed("low" if self._downwards(axis) else "high"):  # already on it: leave it first
            self._pull_off(axis)
            return
        scale = self.settings[100 + index]
        far = float("-inf") if self._downwards(axis) else float("inf")
        motor.go(far, rate_mm_min / 60.0 * scale, self.settings[120 + index] * scale, self.event_s)

    def _pull_off(self, axis: str) -> None:
        index, motor = NAMES.index(axis), self.motors[axis]
        scale = self.settings[100 + index]
        self._phase = {"seek": "leave", "locate": "pull off"}[self._phase]
        away = self.settings[27] * scale * (1.0 if self._downwards(axis) else -1.0)
        speed, ramp = self.settings[25] / 60.0 * scale, self.settings[120 + index] * scale
        motor.go(motor.steps + round(away), speed, ramp, self.event_s)

    def _homing_rest(self, axis: str) -> None:
        if self.motors[axis].is_closed("low" if self._downwards(axis) else "high"):
            self._homing_failed(NOT_CLEARED)
        elif self._phase == "leave":
            self._phase = "locate"
            self._towards(axis, self.settings[24])
        elif self._phase == "pull off":
            index = NAMES.index(axis)
            off_mm = self.settings[27]
            place_mm = off_mm - self.settings[130 + index] if self._downwards(axis) else -off_mm
            self._zero[axis] = self.motors[axis].steps - round(place_mm * self.settings[100 + index])
            self._homing.popleft()
            self._home_next()

    def _homing_failed(self, code: int) -> None:
        """The board tells why, and resets itself."""
        self._state = "Alarm"
        self._forget_work()
        self.say(grbl.Alarm(code).to_bytes())
        self._greet()


EMULATOR = GrblEmulator
