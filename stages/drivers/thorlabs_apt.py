"""Driver for Thorlabs motor boxes with the APT protocol: T-Cubes, K-Cubes, LTS stages, BSC and BBD racks.

A channel is ``1``, ``2``, .. of a unit of its own, or ``bay1``, ``bay2``, .. of a rack. Positions are counts of an
encoder or microsteps, so every channel needs steps_per_mm (34304 or 34555 counts/mm for MTS stages, 409600
microsteps/mm for LTS150 and LTS300). Speeds and accelerations go in units of the box's family (`FAMILIES` of
`stages.drivers.apt_questions`), which its model tells. A model that is not there is refused: a wrong unit means a
wrong speed by a factor of fifty.

**Commands.** Nothing answers a command that moves, so a question for the state goes behind each in the same write:
its answer says that the command was read. Automatic state messages that another program has asked for are
switched off. How it is asked and what is believed of the answers: `stages.drivers.apt_questions`.

**The end of a motion.** Two looks in a row must find rest, and the position must be the target's. Rest short of it
is a limit switch, a fault, a refusal, or else a person's stop. A box that has not begun yet is given `BEGINS_S`;
a reference run of which nothing was seen, neither motion nor end, was none, whatever flag an older one has left.

**Restarts.** A box that has restarted is not homed any more. It may be homed again at its own buttons though, or
by another program with another offset. So homing leaves a mark: the distance of the next relative move, which
is never made here, becomes a number made from the settings of the reference run. A restart wipes it out; a
box that is homed and has the mark is where it says it is, also for the next program.

**Half a command.** Nothing marks where a message begins, so who dies in the middle of one leaves a box that takes
the next bytes for the rest of it, maybe of a target. So a program that opens the port, and the watchdog, send stop
until the longest of our messages must have ended: what has begun by then ends at once.

**Server alive.** Over USB a box that has not heard MOT_ACK_DCSTATUSUPDATE for a second falls silent after about
fifty commands (APT protocol, issue 26, p. 30; one lab has not seen it). It is therefore sent before a query if the
last one is older than `ALIVE_S`, and not while the box is idle.

**Stops.** A servo is stopped at once: its encoder goes on counting. A stepper that is stopped at once loses steps
that is not counted, so it is stopped along its ramp. The box's own backlash correction would drive past the
target; it is switched off before the first move.
"""

import math
import re
from collections.abc import Mapping, Sequence
from zlib import crc32

from stages.clock import SYSTEM_CLOCK, Clock
from stages.controller import Channel
from stages.drivers.apt_questions import FAMILIES, AptQuestions, Family, ident_of, place_of
from stages.errors import (
    AxisStalled,
    CommandRejected,
    DeviceError,
    LimitHit,
    MotionStopped,
    NotReferenced,
    StageUsageError,
    WrongDevice,
)
from stages.protocols import apt_words as words
from stages.protocols import thorlabs_apt as apt
from stages.protocols.apt_words import Kind
from stages.stop_latch import StopLatch

ARRIVAL_TOLERANCE_MM = 0.02  # a motion that ends further from its target was ended by something
BEGINS_S = 0.3  # a box that has taken a command may still seem to rest for as long
MARKS = range(257, 1024)  # counts: nothing to speak of if that move should ever be made
UNTRUSTED_MARK = 256  # the mark of a channel that must not be believed, though there was no restart
LARGEST = 2**31 - 1
LONGEST_BYTES = 20  # of what this driver says: a setting of speeds


class AptController(AptQuestions):
    """One Thorlabs box."""

    default_baud = 115_200
    example_channels = ("bay1", "bay2")
    counts_steps = True
    flow_control = True

    families: Sequence[Family] = FAMILIES  # a subclass may know more

    _family: Family = FAMILIES[-1]
    _profile: dict[str, tuple[int, int]]
    _homing: set[str]
    _not_begun: dict[str, float]  # time by which the motion of a channel must have begun

    def __init__(
        self,
        name: str,
        channels: Mapping[str, Channel],
        clock: Clock = SYSTEM_CLOCK,
        latch: StopLatch | None = None,
    ) -> None:
        super().__init__(name, channels, clock, latch)
        self._sent_to: dict[str, int] = {}  # count where the motion of a channel shall end
        self._rested: set[str] = set()  # seen at rest since their motion began, before our own stop
        self._marks: dict[str, int] = {}  # left in the channels that are referenced

    def start_move(self, channel: str, target_mm: float, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        """Begin an absolute move; NotReferenced if the box has restarted, which is then stopped at once."""
        target = round(target_mm * self._scale(channel))
        if not -LARGEST <= target <= LARGEST:
            raise StageUsageError(
                f"{self.name} channel {channel}: {target_mm:g} mm is more than the box can count"
            )
        self._prepare(channel, self._native(channel, speed_mm_s, acceleration_mm_s2))
        self._begin(
            channel, apt.Setting(Kind.MOT_MOVE_ABSOLUTE, ident_of(channel), target, place_of(channel)), target
        )

    def start_home(self, channel: str) -> None:
        """Begin to look for the reference, in the way that is set in the box."""
        self._referenced.discard(channel)
        self._leave_mark(channel, UNTRUSTED_MARK)
        self._tell(channel, Kind.MOD_SET_CHANENABLESTATE, words.ON)
        self._homing.add(channel)
        self._begin(channel, apt.Order(Kind.MOT_MOVE_HOME, ident_of(channel), 0, place_of(channel)), None)

    def moving(self, channel: str) -> bool:
        """Ask for the state until two answers say that the channel rests, or one that it moves."""
        if self._drives(channel, self._ask_again(lambda: self._bits(channel))):
            return True
        if not self._stopped:
            self._rested.add(channel)
        bits = self._ask_until_equal(lambda: self._bits(channel))
        if self._drives(channel, bits):
            return True
        was_homing = channel in self._homing
        has_begun = channel not in self._not_begun or channel in self._told_homed
        arrived = bits & words.HOMED and has_begun if was_homing else self._is_there(channel)
        if not arrived and self.clock.now_s() < self._not_begun.get(channel, 0.0):
            return True
        self._homing.discard(channel)
        self._not_begun.pop(channel, None)
        if self._stopped:
            raise MotionStopped(f"{self.name} channel {channel} was stopped")
        if was_homing and not arrived and self._ask_until_equal(lambda: self._mark(channel)) != UNTRUSTED_MARK:
            raise NotReferenced(f"{self.name} channel {channel} has restarted while it was homed; home it again")
        if was_homing and bits & words.HOMED and not has_begun:  # from an older run: who knows with what offset
            raise DeviceError(f"{self.name} channel {channel} did not begin its reference run; home it again")
        if not arrived:
            self._raise_why(channel, bits, was_homing)
        if was_homing:
            self._marks[channel] = self._right_mark(channel)
            self._leave_mark(channel, self._marks[channel])
            self._referenced.add(channel)
        return False

    def resolve_missing_reply(self, channel: str) -> None:
        """MotionStopped if it rested short of its target before our own halt: a person may have stopped it."""
        if channel in self._rested and not self._is_there(channel):
            raise MotionStopped(f"{self.name} channel {channel} stopped short of its target for no known reason")

    def position_mm(self, channel: str) -> float:
        """Counts / scale of a channel that rests; StageUsageError if it moves."""

        def ask() -> int:
            moves = words.MOVES | words.HOMING
            if self._bits(channel) & moves and self._ask_until_equal(lambda: self._bits(channel)) & moves:
                # at its wheel, or for another program: two readings may agree by chance
                raise StageUsageError(f"{self.name} channel {channel} is moving; wait until it stops")
            return self._count(channel)

        scale = self._scale(channel)
        return self._settle_reading(channel, ask, self._near(channel, scale)) / scale

    def check_motion(self, channel: str, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        """StageUsageError if a value does not fit the setting it goes to."""
        speed, acceleration = self._native(channel, speed_mm_s, acceleration_mm_s2)
        if not (1 <= speed <= LARGEST and 1 <= acceleration <= LARGEST):
            per_mm = self._scale(channel)
            fastest, steepest = (LARGEST / per_mm / unit for unit in self._family[1:3])
            raise StageUsageError(
                f"{self.name} channel {channel}: {speed_mm_s:g} mm/s and {acceleration_mm_s2:g} mm/s2 do not fit "
                f"the box's settings, up to {fastest:.3g} mm/s and {steepest:.3g} mm/s2; is the scale right?"
            )

    # ---- who answers, and its commands ----------------------------------------------------

    def _get_to_know(self) -> None:
        for data in self.watchdog_bytes():
            self.port.write(data)
        self._alive_s = -math.inf
        for to in self._places:
            self.port.write(apt.Order(Kind.HW_NO_FLASH_PROGRAMMING, to=to).to_bytes())
        super()._get_to_know()

    def _reset_state(self) -> None:
        self._profile, self._not_begun = {}, {}
        self._homing, self._told_homed = set(), set()
        self._complaint = ""

    def _set_up(self) -> None:
        model = self.identity.split()[1]
        known = [family for family in self.families if re.fullmatch(family.models, model)]
        if not known:
            raise WrongDevice(
                f"{self.name}: the speed units of a {model} are not known; give those of its "
                "manual (motor scaling) in the families of a subclass of AptController (docs/add-a-stage.md)"
            )
        self._family = known[0]
        for name in self._channels:
            self._send(apt.Order(Kind.HW_STOP_UPDATEMSGS, to=place_of(name)).to_bytes())
            if self._is_rack and self._ask_again(lambda name=name: self._bay(name)).second != words.ON:  # type: ignore[misc]
                raise WrongDevice(f"{self.name}: there is no card in {name} of this {model}; check the channel")
            self._ask_again(lambda name=name: self._bits(name))  # type: ignore[misc]  # it answers

    def _bay(self, channel: str) -> apt.Reply:
        bay = place_of(channel) - words.FIRST_BAY
        question = apt.Order(Kind.RACK_REQ_BAYUSED, bay, 0, words.RACK)
        return self._ask(
            question.to_bytes(), apt.Reply, lambda a: a.kind == Kind.RACK_GET_BAYUSED and a.first == bay
        )

    def _prepare(self, channel: str, profile: tuple[int, int]) -> None:
        """Set speed and acceleration, see that they are taken, and that the box makes no motions of its own."""
        if self._profile.get(channel) == profile:
            return
        self._profile.pop(channel, None)
        self._tell(channel, Kind.MOD_SET_CHANENABLESTATE, words.ON)
        self._set(channel, Kind.MOT_SET_GENMOVEPARAMS, 0)
        if self._ask_until_equal(lambda: self._value(channel, Kind.MOT_REQ_GENMOVEPARAMS)) != 0:
            raise DeviceError(f"{self.name} channel {channel} keeps its own backlash correction; switch it off")
        speed, acceleration = profile
        self._send(apt.SetSpeeds(ident_of(channel), 0, acceleration, speed, place_of(channel)).to_bytes())
        taken = self._ask_until_equal(lambda: self._speeds(channel))
        if taken != (speed, acceleration):
            fastest, steepest = (
                number / self._scale(channel) / unit for number, unit in zip(taken, self._family[1:3], strict=True)
            )
            raise StageUsageError(
                f"{self.name} channel {channel} did not accept its speed: its maximum is {fastest:.4g} mm/s with "
                f"{steepest:.4g} mm/s2; set at most these in the bench file"
            )
        self._profile[channel] = profile

    def _native(self, channel: str, speed_mm_s: float, acceleration_mm_s2: float) -> tuple[int, int]:
        scale = self._scale(channel)
        return (
            round(speed_mm_s * scale * self._family.speed),
            round(acceleration_mm_s2 * scale * self._family.acceleration),
        )

    # ---- references ----------------------------------------------------------------------------

    def _still_referenced(self, channel: str) -> bool:
        def vouches() -> bool:
            is_homed = self._ask_again(lambda: self._bits(channel)) & words.HOMED
            return bool(is_homed) and self._mark(channel) == self._marks.get(channel)

        return vouches() or self._ask_until_equal(vouches)

    def _remembers_reference(self, channel: str) -> bool:
        self._marks[channel] = self._right_mark(channel)
        return self._still_referenced(channel)

    def _forget_references(self) -> None:
        super()._forget_references()
        self._profile, self._marks = {}, {}

    def _mark(self, channel: str) -> int:
        return self._ask_again(lambda: self._value(channel, Kind.MOT_REQ_MOVERELPARAMS))

    def _right_mark(self, channel: str) -> int:
        """The number that stands for a reference run as it is set now."""
        how = self._ask_again(lambda: self._homing_settings(channel))
        return MARKS[crc32(repr((how.direction, how.switch, how.offset)).encode()) % len(MARKS)]

    def _leave_mark(self, channel: str, mark: int) -> None:
        self._set(channel, Kind.MOT_SET_MOVERELPARAMS, mark)
        if self._ask_until_equal(lambda: self._mark(channel)) != mark:
            raise DeviceError(
                f"{self.name} channel {channel} keeps no number for us, so its restarts could not be noticed; "
                "this box cannot be used"
            )

    # ---- motions -------------------------------------------------------------------------------

    def _begin(self, channel: str, order: apt.Command, target: int | None) -> None:
        """Send what moves and a question behind it; the answer to that says that both were read."""
        self._stopped = False
        self._complaint = ""
        self._told_homed.discard(channel)
        self._rested.discard(channel)
        self._sent_to.pop(channel, None)
        if target is not None:
            self._sent_to[channel] = target
        self._not_begun[channel] = self.clock.now_s() + BEGINS_S
        bits = self._bits(channel, before=order.to_bytes())
        if target is not None:
            self._refuse_restarted(channel, bits)

    def _drives(self, channel: str, bits: int) -> bool:
        if channel not in self._homing:
            self._refuse_restarted(channel, bits)
        if bits & (words.MOVES | words.HOMING):
            self._not_begun.pop(channel, None)
            self._rested.discard(channel)
            return True
        return False

    def _refuse_restarted(self, channel: str, bits: int) -> None:
        """A box that is not homed any more counts from somewhere else, and what it drives to is nowhere."""
        if bits & words.HOMED or channel not in self._referenced:
            return
        if not self._ask_until_equal(lambda: self._bits(channel)) & words.HOMED:
            self.stop()
            self._forget_references()
            raise NotReferenced(f"{self.name} channel {channel} has restarted; stopped at once, home it")

    def _is_there(self, channel: str) -> bool:
        if channel not in self._sent_to:
            return True
        count = self._ask_until_equal(lambda: self._count(channel), self._near(channel, self._scale(channel)))
        return abs(count - self._sent_to[channel]) <= ARRIVAL_TOLERANCE_MM * self._scale(channel) + 1

    def _raise_why(self, channel: str, bits: int, was_homing: bool) -> None:
        """Say what has ended a motion that was to go on; reference runs meet switches, so no switch ends them."""
        where = f"{self.name} channel {channel}"
        faults = [what for bit, what in words.FAULTS.items() if bits & bit]
        at_switch = bits & (words.UPPER_SWITCH | words.LOWER_SWITCH) and not was_homing
        if faults or at_switch:
            self._referenced.discard(channel)
            self._leave_mark(channel, UNTRUSTED_MARK)  # nor shall the next program believe it
        if faults:
            raise AxisStalled(f"{where} has ended its motion: {'; '.join(faults)}; clear the way and home it")
        if at_switch and self._was_driven_back(channel, bits):
            raise MotionStopped(f"{where} was turned into a limit switch at its wheel; home it")
        if at_switch:
            raise LimitHit(f"{where} ran into a limit switch; home it")
        if self._complaint:
            raise CommandRejected(f"{where} refused to move: {self._complaint}", self._complaint)
        raise MotionStopped(
            f"{where} has ended its motion before its end: stopped or off at the box, or its power failed?"
        )

    def _was_driven_back(self, channel: str, bits: int) -> bool:
        """Return whether the target lies away from the switch: then something else than our motion went there."""
        if channel not in self._sent_to:
            return False
        count = self._ask_until_equal(lambda: self._count(channel), self._near(channel, self._scale(channel)))
        return bool(bits & (words.LOWER_SWITCH if self._sent_to[channel] > count else words.UPPER_SWITCH))

    def _stop_bytes(self) -> Sequence[bytes]:
        how = words.STOP_AT_ONCE if self._family.has_encoder else words.STOP_SLOWING
        return [
            apt.Order(Kind.MOT_MOVE_STOP, ident_of(name), how, place_of(name)).to_bytes()
            for name in self._channels
        ]

    def watchdog_bytes(self) -> Sequence[bytes]:
        """The stops, behind whatever a program that died may have left unfinished."""
        times = 2 + LONGEST_BYTES // words.HEADER
        return [data * times for data in self._stop_bytes()]
