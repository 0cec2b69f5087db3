"""Plays a sequence on a bench; whoever judges is the witness, who asks the carriages.

What programs may raise is `StageError`; anything else that they raise is a finding too ("crash"). A stop of
another thread falls where the real thread could have got in (`sim.emulators.line`). A person's stop at a box
counts as a stop from the moment at which it truly ends a motion short of its target: where it ends nothing,
nobody can know of it. A killed program sends nothing more; what moves goes on to its end, and the next program
begins.
"""

import math
import random
import threading
from collections.abc import Callable
from functools import partial
from typing import Any

from sim.emulators.faults import Fault
from stages.errors import StageError
from stages.protocols import grbl
from tests.fuzz.benches.bench import AXES, FuzzBench
from tests.fuzz.benches.sequences import Sequence

ENDS_S = 40.0  # every motion of the bench has ended after as long
SHORT_MM = 0.1  # a person's stop so close before the target leaves no trace
JOIN_S = 15.0


class Killed(BaseException):
    """kill -9: nothing of the program runs any more."""


class Player:
    """Plays one sequence.

    Parameters
    ----------
    bench : FuzzBench
        Homed; it is used up.
    """

    def __init__(self, bench: FuzzBench) -> None:
        self.bench = bench
        self.witness = bench.world.witness
        self.crashes: list[str] = []
        self.told = 0
        self.done: list[str] = []
        self._is_alone = True  # no other thread may move what has just been told
        self._turned = ""  # axis whose knob was turned during the present command: what was read before is old
        self._pressed_at = ""  # the box at which a person has stopped a motion
        self._orphans = False  # something may still move that a killed program has begun

    def play(self, sequence: Sequence) -> list[str]:
        """Return what must not have happened, one line each."""
        random.seed(1)
        for command in sequence:
            for trap in command.traps:
                self._set(*trap)
            self._try(command.do)
            self._disarm()
            if command.do[0] in ("restart", "move", "home", "connect", "program", "slip"):
                self._ask()
        self._ask()
        self.bench.clock.sleep_s(ENDS_S)
        self._ask()
        return self.crashes + [str(violation) for violation in self.witness.judge()]

    def _try(self, do: list[Any]) -> None:
        try:
            self._do(do)
            self.done.append("done")
        except StageError as error:
            self.done.append(type(error).__name__)
        except Killed:
            self.done.append("Killed")
            self._disarm()
            self._start_program()
            self._orphans = True
        except Exception as error:
            place = error.__traceback__
            while place is not None and place.tb_next is not None:
                place = place.tb_next
            where = f"{place.tb_frame.f_code.co_filename}:{place.tb_lineno}" if place else ""
            self.crashes.append(f"crash of {do[0]}: {type(error).__name__}: {error} ({where})")

    def _do(self, do: list[Any]) -> None:
        stage, lines = self.bench.stage, self.bench.lines
        match do:
            case ["move", targets]:
                for name, arrival in stage.move(targets).items():
                    self._told(name, arrival.measured_mm)
            case ["move_one", axis, target_mm]:
                self._told(axis, stage.axis(axis).move_to(target_mm).measured_mm)
            case ["jog", axis, distance_mm]:
                self._told(axis, stage.axis(axis).move_by(distance_mm).measured_mm)
            case ["home", axes]:
                stage.home(axes)
            case ["stop"]:
                self._stop()
            case ["halt"]:
                stage.halt()
            case ["clear"]:
                self._cleared()
                stage.clear_stop()
            case ["where"]:
                self._ask()
            case ["connect", controller]:
                stage.connect(controller)
            case ["program"]:
                stage.close()
                self._start_program()
            case ["wait", seconds]:
                self.bench.clock.sleep_s(seconds)
            case ["restart", controller, off_s]:
                self._restart(controller, off_s)
            case ["unplug", controller]:
                self._unplug(controller)
            case ["plug", controller]:
                lines[controller].plug_in()
            case ["person", controller]:
                self._person(controller)
            case ["slip" | "shove" as how, axis, distance_mm] if not self.bench.world.is_moving:
                getattr(self.bench.world, how)(axis, distance_mm)
            case ["slip" | "shove", *_]:
                return  # into what moves now nobody could look ahead
            case ["block", axis, distance_mm]:
                motor = self.bench.world.motors[axis]
                motor.obstacle_mm = motor.carriage_mm + distance_mm
            case ["resume" | "reset" as button, controller]:
                self._press(controller, button)
            case ["turn", axis, distance_mm]:
                self._turn(axis, distance_mm)
            case ["noise", axis, steps]:
                self.bench.world.motors[axis].noise_steps = steps
            case ["bounce", axis]:
                self._bounce(axis)
            case ["echo", controller, has_echo]:
                lines[controller].has_echo = has_echo
            case ["beside", other, main]:
                self._beside(other, main)
            case _:
                raise ValueError(f"no such command: {do}")

    # ---- what happens besides ------------------------------------------------------------------

    def _set(self, controller: str, what: str, number: float, action: list[Any]) -> None:
        line = self.bench.lines[controller]
        if what == "seconds":
            self.bench.clock.after(number, lambda: self._happens(controller, action))
        elif action[0] in ("stop", "halt"):
            line.hooks.press(int(number), what, lambda: self._happens(controller, action), self._is_kept_out)
        else:
            line.hooks.after(int(number), what, lambda: self._happens(controller, action))

    def _happens(self, controller: str, action: list[Any]) -> None:
        line = self.bench.lines[controller]
        self.done.append("!" + (action[1] if action[0] == "fault" else action[0]))
        match action:
            case ["restart", off_s]:
                self._restart(controller, off_s)
            case ["unplug"]:
                self._unplug(controller)
            case ["person"]:
                self._person(controller)
            case ["resume" | "reset" as button]:
                self._press(controller, button)
            case ["stop"]:
                self._stop()
            case ["halt"]:
                self._forget_press()
                self.bench.stage.halt_quietly()
                self._forget_press()  # pressed in the very exchange of our halt: the box tells both alike
            case ["kill"]:
                for other in self.bench.lines.values():
                    other.close()
                raise Killed
            case ["fault", kind, delay_s, *times]:
                line.faults.strike(Fault(kind, delay_s=delay_s), *times)
            case ["turn", axis, distance_mm]:
                self._turn(axis, distance_mm)
            case ["bounce", axis]:
                self._bounce(axis)
            case ["replug", after_s]:
                self._unplug(controller)
                self.bench.clock.after(after_s, line.plug_in)

    def _disarm(self) -> None:
        """What has not happened by now does not happen; what is unplugged stays so."""
        self._turned = ""
        self.bench.clock.clear()
        for line in self.bench.lines.values():
            line.hooks.clear()

    def _is_kept_out(self) -> bool:
        """Whether the present thread holds what a stop of another one waits for."""
        return self.bench.stage.latch._gate._is_owned()  # type: ignore[attr-defined]

    def _stop(self) -> None:
        self.witness.note_stop()
        self.bench.stage.stop_quietly()

    def _person(self, controller: str) -> None:
        """Somebody stops the box at its keys; what is held there stays so until it is released there."""
        self._take_over(controller, self.bench.lines[controller].emulator.person_stops)
        self._note_hold(controller)

    def _turn(self, axis: str, distance_mm: float) -> None:
        """Somebody turns a knob, which ends what the axis was sent on."""
        controller, channel = AXES[axis]["controller"], str(AXES[axis]["channel"])
        emulator, steps = self.bench.lines[controller].emulator, round(distance_mm * AXES[axis]["steps_per_mm"])
        device, slash, number = channel.partition("/")
        turn = (
            partial(emulator.turn_knob, int(device), int(number))
            if slash
            else partial(emulator.turn_wheel, channel)
        )
        self._take_over(controller, lambda: turn(steps), axis)
        self._turned = axis

    def _bounce(self, axis: str) -> None:
        """A switch closes for a moment; within a reference run nothing could tell it from the right one."""
        line, channel = self.bench.lines[AXES[axis]["controller"]], str(AXES[axis]["channel"])
        motor = line.emulator.motors[channel]
        line.emulator.advance()
        if motor.listener is not None and line.emulator.is_on and line.emulator.purpose(channel) == "move":
            motor.listener.on_edge("high", True)

    def _cleared(self) -> None:
        """A person releases the bench; a box that is held at its own keys is not released by that."""
        self.witness.note_clear()
        self._note_hold("portal")

    def _note_hold(self, controller: str) -> None:
        line = self.bench.lines[controller]
        if getattr(line.emulator, "is_held", False):
            self.witness.note_stop(only=line)

    def _take_over(self, controller: str, act: Callable[[], object], only: str = "") -> None:
        """Let a person do something that ends motions; one that ends short of its target is a stop."""
        emulator = self.bench.lines[controller].emulator
        emulator.advance()
        before = {
            name: motor.target
            for name, motor in emulator.motors.items()
            if motor.running
            and emulator.purpose(name) != "hand"
            and (not only or name == str(AXES[only]["channel"]))
        }
        act()
        for name, target in before.items():
            motor = emulator.motors[name]
            short = abs(target - motor.target) * motor.mechanics.lead_mm / motor.mechanics.steps_per_rev
            if short > SHORT_MM and not self._orphans and self.bench.lines[controller].is_reached:
                self.witness.note_stop()
                self._pressed_at = controller

    def _press(self, controller: str, button: str) -> None:
        """Somebody lets a held board go on, or resets it at a pendant."""
        self.witness.note_clear(self.bench.lines[controller])
        self.bench.lines[controller].emulator.button(grbl.RESUME if button == "resume" else grbl.RESET)

    def _restart(self, controller: str, off_s: float) -> None:
        """Power fails."""
        if controller == self._pressed_at:
            self._forget_press()
        self.witness.note_clear(self.bench.lines[controller])
        self.bench.lines[controller].power_cycle(off_s)

    def _unplug(self, controller: str) -> None:
        """The cable is pulled; what the box would have told is not heard."""
        if controller == self._pressed_at:
            self._forget_press()
        self.bench.lines[controller].unplug()

    def _forget_press(self) -> None:
        """Nothing tells a person's stop any more, if the program has not heard of it by now."""
        if self._pressed_at and not self.bench.stage.is_held:
            self._cleared()

    def _start_program(self) -> None:
        self._cleared()
        self.bench.start_program()

    def _beside(self, other: list[Any], main: list[Any]) -> None:
        """Two threads at once: what each of them comes across first is the machine's business."""

        def run() -> None:
            if other == ["stop"]:
                self.bench.stage.stop_quietly()
                self.witness.note_stop()
            else:
                self._try(other)

        thread = threading.Thread(target=run, daemon=True)
        self._is_alone = False
        thread.start()
        try:
            self._do(main)
        finally:
            thread.join(JOIN_S)
            self._is_alone = True
            if thread.is_alive():
                self.crashes.append(f"crash of beside: {other} hangs")

    # ---- what is believed ----------------------------------------------------------------------

    def _ask(self) -> None:
        try:
            where_mm = self.bench.stage.where_mm()
        except StageError:
            return
        for name, at_mm in where_mm.items():
            if at_mm is not None:
                self._told(name, at_mm)

    def _told(self, axis: str, at_mm: float) -> None:
        if not self._is_alone or axis == self._turned:
            return
        self.told += 1
        if not math.isfinite(at_mm):
            self.crashes.append(f"crash of {axis}: told {at_mm}")
        self.witness.check_report(axis, at_mm)
