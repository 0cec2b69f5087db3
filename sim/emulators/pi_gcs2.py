"""A PI controller with General Command Set 2.0, one servo axis per motor, or a chain of several on one port.

Positions are mm, made from the counts of an encoder on the motor with the firmware's own counts per mm. The
reference run goes below the reference edge and up onto it; there the position is `reference_mm`. A stage that has
limit switches only is referenced at one of them (FNL, FPL): onto it and off again. During it only queries and
stops are taken. An axis that cannot follow switches its servo off and leaves error -1024. A
stop leaves error 10, moving or not. Errors wait until ERR? takes them. After power-up servos are off, references
gone, and positions count from where the axes stand, unless their encoders are absolute.
"""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

from sim.emulators.device import Clock, Emulator, Purpose
from sim.mechanics.motion import Motor
from stages.errors import ProtocolViolation
from stages.protocols import pi_gcs2 as gcs

HELP = (
    "#5 #7 #24 CSV? *IDN? SAI? SVO SVO? FRF FRF? FNL FPL TRS? LIM? MOV MVR MOV? POS? ONT? VEL VEL? ACC DEC TMN? "
    "TMX? HLT STP ERR? HLP?"
)
ON_SWITCH = 216
REFERENCE_MM_S = 20.0  # a parameter of its own, not VEL


class _Axis:
    """One servo axis."""

    def __init__(self, motor: Motor, counts_per_mm: float, reference_mm: float, travel_mm: float) -> None:
        self.motor = motor
        motor.listener = self
        self.counts_per_mm = counts_per_mm
        self.reference_mm = reference_mm
        self.travel_mm = travel_mm
        self.zero = 0  # encoder count at position 0
        self.referenced = False
        self.power_up(absolute=True)

    def power_up(self, absolute: bool) -> None:
        if not absolute:
            self.zero, self.referenced = self.motor.encoder_steps, False
        self.servo = False
        self.referencing = ""
        self.speed_mm_s, self.ramp_mm_s2 = 10.0, 100.0
        self.target_mm = self.position_mm
        self.error = gcs.NO_ERROR

    @property
    def position_mm(self) -> float:
        return (self.motor.encoder_steps - self.zero) / self.counts_per_mm

    def go(self, target: float, speed_mm_s: float) -> None:
        self.motor.go(target, speed_mm_s * self.counts_per_mm, self.ramp_mm_s2 * self.counts_per_mm)

    def move(self, target_mm: float) -> None:
        self.target_mm = target_mm
        offset = self.motor.steps - self.motor.encoder_steps  # the servo makes lost pulses up
        self.go(round(target_mm * self.counts_per_mm) + self.zero + offset, self.speed_mm_s)

    def reference(self) -> None:
        self.referenced = False
        if self.motor.is_closed("index"):
            self.referencing = "down"
            self.go(float("-inf"), REFERENCE_MM_S)
        else:
            self._up()

    def reference_at(self, upper: bool) -> None:
        """Onto a limit switch; there it halts, and goes off it again."""
        self.referenced = False
        if self.motor.is_closed("high" if upper else "low"):
            self._off_switch(upper)
        else:
            self.referencing = "onto high" if upper else "onto low"
            self.go(float("inf") if upper else float("-inf"), REFERENCE_MM_S)

    def _off_switch(self, upper: bool) -> None:
        self.referencing = "off high" if upper else "off low"
        self.go(float("-inf") if upper else float("inf"), REFERENCE_MM_S / 10.0)

    def stop(self) -> None:
        self.referencing = ""
        self.motor.brake(self.ramp_mm_s2 * self.counts_per_mm)

    def on_edge(self, name: str, upwards: bool) -> None:
        if name == "blocked":
            self._fail(gcs.MOTION_ERROR)
            self.servo = False
        elif name == "index" and self.referencing == "down" and not upwards:
            self.motor.halt()
            self._up()
        elif name == "index" and self.referencing == "up" and upwards:
            self.motor.halt()
            self.zero = self.motor.encoder_steps - round(self.reference_mm * self.counts_per_mm)
            self.target_mm, self.referenced, self.referencing = self.reference_mm, True, ""
        elif name in ("low", "high") and self.referencing == f"onto {name}":
            self.motor.halt()
            self._off_switch(name == "high")
        elif name in ("low", "high") and self.referencing == f"off {name}":
            self.motor.halt()
            at_mm = self.travel_mm if name == "high" else 0.0
            self.zero = self.motor.encoder_steps - round(at_mm * self.counts_per_mm)
            self.target_mm, self.referenced, self.referencing = at_mm, True, ""
        elif (name == "low" and not upwards) or (name == "high" and upwards):
            self._fail(ON_SWITCH)

    def on_rest(self) -> None:
        return

    def _up(self) -> None:
        self.referencing = "up"
        self.go(float("inf"), REFERENCE_MM_S / 10.0)

    def _fail(self, error: int) -> None:
        self.motor.halt()
        self.referencing, self.error = "", error


@dataclass(frozen=True, slots=True)
class StageMake:
    """Stages on a controller as they were made, and the settings of their maker.

    Parameters
    ----------
    counts_per_mm : float, optional
        The firmware's scale; that of the motors' lead and steps by default, as the maker would set it.
    reference_mm, travel_mm : float, optional
        Position of the reference edge, and of the upper end of the commandable range.
    absolute_encoders : bool
        Positions survive a loss of power once they have been referenced.
    switches : {"reference", "limits", "none"}
        What they have.
    """

    counts_per_mm: float | None = None
    reference_mm: float | None = None
    travel_mm: float | None = None
    absolute_encoders: bool = False
    switches: Literal["reference", "limits", "none"] = "reference"


AS_BUILT = StageMake()


class PiEmulator(Emulator):
    """One controller, or a chain of them.

    Parameters
    ----------
    motors : mapping of str to Motor
        Motors by axis name; by address and axis (``2/1``) of a chain.
    clock : Clock
        Time of the world.
    stages : StageMake
        How its stages were made.
    serial : int
        Serial number.
    knows_switches : bool
        Whether it answers TRS? and LIM?.
    command_set : str, optional
        What it says to CSV?; None for one that does not know the question. Of one beyond 2.0 no more is
        emulated than that, its name and ERR?, and that it knows no word of GCS 2.
    """

    decoder = gcs.CommandStream
    has_serial = True

    def __init__(
        self,
        motors: Mapping[str, Motor],
        clock: Clock,
        stages: StageMake = AS_BUILT,
        serial: int = 118_040_001,
        knows_switches: bool = True,
        command_set: str | None = "2.0",
    ) -> None:
        super().__init__(motors, clock)
        self._command_set = command_set
        self._stages, self._serial, self._knows_switches = stages, serial, knows_switches
        # axes by address; one without an address is alone
        self._chain: dict[int | None, dict[str, _Axis]] = {}
        self._errors: Counter[int | None] = Counter()
        self._spoken_to: int | None = None  # address of the one that answers now
        self._names_sender = False
        for name, motor in self.motors.items():
            screw = motor.mechanics
            counts_per_mm = stages.counts_per_mm or screw.steps_per_rev / screw.lead_mm
            whole_mm, edge_mm = screw.high_switch_mm - screw.low_switch_mm, screw.index_mm - screw.low_switch_mm
            travel_mm = whole_mm if stages.travel_mm is None else stages.travel_mm
            reference_mm = edge_mm if stages.reference_mm is None else stages.reference_mm
            address, slash, _ = name.partition("/")
            axes = self._chain.setdefault(int(address) if slash else None, {})
            axes[name.rpartition("/")[2]] = _Axis(motor, counts_per_mm, reference_mm, travel_mm)

    def person_stops(self) -> None:
        """Stop every axis through another interface of the controller."""
        self.advance()
        for address in self._chain:
            self._spoken_to = address
            self._single(gcs.STOP_ALL)

    def purpose(self, channel: str) -> Purpose:
        """A reference run, or a motion."""
        address, slash, _ = channel.partition("/")
        axis = self._chain[int(address) if slash else None][channel.rpartition("/")[2]]
        return "reference" if axis.referencing else "move"

    @property
    def _axes(self) -> dict[str, _Axis]:
        """Those of the controller that is spoken to."""
        return self._chain[self._spoken_to]

    @property
    def _is_newer(self) -> bool:
        return self._command_set is not None and float(self._command_set) > 2.0

    @property
    def _error(self) -> int:
        return self._errors[self._spoken_to]

    @_error.setter
    def _error(self, code: int) -> None:
        self._errors[self._spoken_to] = code

    def _is_there(self, address: int | None) -> bool:
        """Turn to the one that is meant; without an address the only one, or number 1 of a chain."""
        self._names_sender = address is not None and None not in self._chain
        self._spoken_to = None if None in self._chain else address or 1
        return self._spoken_to in self._chain and not (address and None in self._chain)

    def _power_up(self) -> None:
        self._errors.clear()
        for axes in self._chain.values():
            for axis in axes.values():
                axis.power_up(self._stages.absolute_encoders)

    def _hear(self, command: gcs.Command | gcs.SingleByte | ProtocolViolation) -> None:
        if not self._is_there(None if isinstance(command, ProtocolViolation) else command.address):
            return
        if isinstance(command, gcs.SingleByte):
            if not self._is_newer:
                self._single(command.code)
        elif isinstance(command, ProtocolViolation):
            self._error = gcs.UNKNOWN_COMMAND
        elif command.is_query:
            self._query(command)
        elif self._is_newer:
            self._error = gcs.UNKNOWN_COMMAND
        elif command.name not in ("STP", "HLT") and any(axis.referencing for axis in self._axes.values()):
            self._error = gcs.NOT_ALLOWED
        else:
            self._error = self._obey(command) or self._error

    def _tick(self, now_s: float) -> None:
        for address, axes in self._chain.items():
            for axis in axes.values():
                if axis.error:
                    self._errors[address], axis.error = axis.error, gcs.NO_ERROR

    def _answer(self, *lines: str) -> None:
        self.say(gcs.Answer(lines, self._spoken_to if self._names_sender else None).to_bytes())

    def _single(self, code: int) -> None:
        if code == gcs.MOVING:
            mask = sum(axis.motor.running << bit for bit, axis in enumerate(self._axes.values()))
            self._answer(f"{mask:X}")
        elif code == gcs.READY:
            busy = any(axis.referencing for axis in self._axes.values())
            self._answer((gcs.BUSY_BYTE if busy else gcs.READY_BYTE).decode("latin-1"))
        elif code == gcs.STOP_ALL:
            for axis in self._axes.values():
                axis.stop()
            self._error = gcs.STOPPED

    def _query(self, command: gcs.Command) -> None:
        plain = {
            "*IDN?": "(c)2019 Physik Instrumente (PI) GmbH & Co. KG, C-663.12, "
            f"{self._serial + (self._spoken_to or 0):010d}, 1.2.1.0",
        }
        if self._command_set is not None:
            plain["CSV?"] = self._command_set
        per_axis: dict[str, Callable[[_Axis], str]] = {
            "POS?": lambda axis: f"{axis.position_mm + axis.motor.flicker() / axis.counts_per_mm:.7f}",
            "MOV?": lambda axis: f"{axis.target_mm:.7f}",
            "ONT?": lambda axis: str(int(not axis.motor.running and axis.servo)),
            "SVO?": lambda axis: str(int(axis.servo)),
            "FRF?": lambda axis: str(int(axis.referenced)),
            "VEL?": lambda axis: f"{axis.speed_mm_s:.6f}",
            "TMN?": lambda axis: "0.0000000",
            "TMX?": lambda axis: f"{axis.travel_mm:.7f}",
            "RON?": lambda axis: "1",
        }
        if self._knows_switches:
            per_axis["TRS?"] = lambda axis: str(int(self._stages.switches == "reference"))
            per_axis["LIM?"] = lambda axis: str(int(self._stages.switches != "none"))
        if command.name in plain:
            self._answer(plain[command.name])
        elif command.name == "ERR?":
            self._answer(str(self._error))
            self._error = gcs.NO_ERROR
        elif self._is_newer:
            self._error = gcs.UNKNOWN_COMMAND
        elif command.name == "SAI?":
            self._answer(*self._axes)
        elif command.name == "HLP?":
            self._answer(*HELP.split())
        elif command.name not in per_axis:
            self._error = gcs.UNKNOWN_COMMAND
        elif any(name not in self._axes for name in command.arguments):
            self._error = gcs.BAD_AXIS
        else:
            show = per_axis[command.name]
            self._answer(*(f"{name}={show(self._axes[name])}" for name in command.arguments or self._axes))

    def _obey(self, command: gcs.Command) -> int:
        if command.name in ("STP", "HLT"):
            for name, axis in self._axes.items():
                if command.name == "STP" or not command.arguments or name in command.arguments:
                    axis.stop()
            return gcs.STOPPED
        if command.name in ("FRF", "FNL", "FPL"):
            return self._reference(command.name, command.arguments or tuple(self._axes))
        if command.name not in ("SVO", "MOV", "MVR", "VEL", "ACC", "DEC"):
            return gcs.UNKNOWN_COMMAND
        wishes = list(zip(command.arguments[::2], command.arguments[1::2], strict=False))
        if len(command.arguments) % 2 or not wishes:
            return 1
        try:
            numbers = [(name, gcs.number(text)) for name, text in wishes]
        except ProtocolViolation:
            return 1
        if any(name not in self._axes for name, _ in numbers):
            return gcs.BAD_AXIS
        for name, number in numbers:
            if error := self._set(command.name, self._axes[name], number):
                return error
        return gcs.NO_ERROR

    def _reference(self, how: str, names: tuple[str, ...]) -> int:
        if any(name not in self._axes for name in names):
            return gcs.BAD_AXIS
        if not all(self._axes[name].servo for name in names):
            return gcs.NOT_ALLOWED
        if self._stages.switches == "none" or (how == "FRF" and self._stages.switches != "reference"):
            return gcs.NOT_ALLOWED
        for name in names:
            if how == "FRF":
                self._axes[name].reference()
            else:
                self._axes[name].reference_at(how == "FPL")
        return gcs.NO_ERROR

    def _set(self, what: str, axis: _Axis, number: float) -> int:
        if what == "SVO":
            axis.servo = bool(number)
        elif what in ("VEL", "ACC", "DEC"):
            if not 0.0 < number <= 1e5:
                return 8
            if what == "VEL":
                axis.speed_mm_s = number
            else:
                axis.ramp_mm_s2 = number
        elif not (axis.servo and axis.referenced):
            return gcs.NOT_ALLOWED
        else:
            target_mm = number if what == "MOV" else axis.target_mm + number
            if not -1e-6 <= target_mm <= axis.travel_mm + 1e-6:
                return gcs.OUT_OF_LIMITS
            axis.move(target_mm)
        return gcs.NO_ERROR


EMULATOR = PiEmulator
