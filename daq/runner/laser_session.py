"""The laser of a run: warm once, one confirmation by the operator, a chunk at a time, and off in every end.

The code is asked for once a run and holds for its chunks; it is the one that the laser has made up when it was
opened (daq.timing.laser), so no plan, script or habit can hold it.
"""

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import cycle
from typing import Protocol, cast

from daq.bench.guards import sheet_clearance_mm
from daq.bench.opened import OpenBench, require_positions
from daq.cameras.camera import Setting
from daq.cameras.link import first_of
from daq.errors import DaqError, PlanError, RunInterrupted, RunUsageError
from daq.plans.pulse_order import PulseOrder, check_marker, pair_exposures, pairs_section
from daq.runner.camera_session import EXPOSURES_US, RATES_HZ
from daq.runner.interrupts import Interrupts
from daq.runner.pair_source import Chunk
from daq.runs.laser_proof import proof_sentence
from daq.runs.run_folder import RunFolder
from daq.timing.conditions import Conditions
from daq.timing.laser import Laser
from daq.timing.pulses import PairExposures
from daq.timing.states import EMITS, LaserState
from daq.timing.supervisor import LaserSupervisor
from stages.clock import SYSTEM_CLOCK
from stages.errors import StageError
from stages.scale_question import ScaleQuestion

WARM_UP_POLL_S = 0.05


class Operator(Protocol):
    """The person at the bench."""

    def confirmation_code(self, challenge: str, watched: str) -> str:
        """Return what was typed when the laser asked for its code; `watched` is shown with it."""

    def open_seeding(self) -> None:
        """Return when the seeding has been opened; the background is done."""

    def stands_mm(self, axis: str) -> float:
        """Return where an axis stands that is homed by hand, as read on its scale [mm]."""

    def reads(self, question: ScaleQuestion, given_up: Callable[[], bool]) -> str | None:
        """Have an axis turned that has no motor, and return what was typed; see `stages.scale_question.Person`."""


def no_hands(axes: Sequence[str]) -> str:
    """Say that there is no operator to move some axes."""
    return (
        f"{', '.join(axes)} {'are' if len(axes) > 1 else 'is'} moved by hand, and what a person reads is typed at "
        "the terminal: run this at one, with nothing piped into it (or --simulate, where a simulated hand turns)"
    )


def what_is_proven(hardware: OpenBench, name: str, laser: Laser) -> str:
    """Return what is proven of the laser's timing unit, as part of a sentence for the operator."""
    channels = {role.value: output for role, output in laser.box.wiring.items()}
    simulated = hardware.simulation is not None
    return proof_sentence(hardware.bench.path, name, laser.box.identity, channels, simulated)


class NoOperator:
    """Stand-in for an operator who is absent."""

    def confirmation_code(self, challenge: str, watched: str) -> str:
        """Refuse: there is no terminal.

        Raises
        ------
        RunUsageError
            Always.
        """
        raise RunUsageError(
            "the code that arms the laser cannot be typed here; use a terminal, or --operator NAME for a"
            " simulated one"
        )

    def open_seeding(self) -> None:
        """Go on."""

    def stands_mm(self, axis: str) -> float:
        """Refuse: there is no terminal.

        Raises
        ------
        RunUsageError
            Always.
        """
        raise RunUsageError(
            f"{axis} is homed by hand, which needs an operator at a terminal to enter its position"
        )

    def reads(self, question: ScaleQuestion, given_up: Callable[[], bool]) -> str | None:
        """Refuse: there is no terminal.

        Raises
        ------
        RunUsageError
            Always.
        """
        raise RunUsageError(no_hands([question.axis]))


class LaserSession:
    """The laser of one session.

    Parameters
    ----------
    hardware : OpenBench
        Open.
    folder : RunFolder
        On the disk that has to have room.
    operator : Operator
        Confirms.
    interrupts : Interrupts
        What was asked for meanwhile.
    """

    synchroniser = ""  # that triggers camera and light; "" for a box of the bench
    doing = "firing"

    def __init__(self, hardware: OpenBench, folder: RunFolder, operator: Operator, interrupts: Interrupts) -> None:
        self._hardware = hardware
        self._folder = folder
        self._operator = operator
        self._interrupts = interrupts
        self._laser: Laser | None = None
        self._code = ""
        self._where_mm: dict[str, float | None] = {}
        self._turn: Iterator[str] = iter(())
        self.exposures: PairExposures | None = None

    @property
    def state(self) -> LaserState | None:
        """State of the laser; None before it is asked for."""
        return None if self._laser is None else self._laser.state

    @property
    def is_firing(self) -> bool:
        """True if triggers are to be expected."""
        return self.state in EMITS

    def account(self, chunk: Chunk) -> None:
        """Nothing: the box has counted what it fired."""

    def prepare(self, order: PulseOrder, settings: Mapping[str, Setting], tell: Callable[[str], None]) -> Laser:
        """Bring the laser to where it can be armed with these pulses; nothing is fired.

        Parameters
        ----------
        order : PulseOrder
            What is asked for.
        settings : mapping
            What the camera read back.
        tell : callable
            Called with what is being done.

        Raises
        ------
        RunUsageError
            Camera and pulses do not go together, or the code is not confirmed.
        TimingError, StageError
            The laser cannot.
        RunInterrupted
            The end was asked for while it warmed up.
        """
        section = pairs_section(self._hardware.bench)
        exposure_us = exposure_of(settings)
        require_rate(settings, section.frames, order.rate_hz)
        check_marker(section, exposure_us, order.rate_hz)
        self.exposures = pair_exposures(section, exposure_us)
        assert order.laser is not None
        laser = cast("Laser", self._hardware.devices[order.laser])
        self._laser = laser
        if laser.state is LaserState.UNKNOWN:
            laser.safe()
        if laser.state is LaserState.SAFE:
            proof = what_is_proven(self._hardware, order.laser, laser)
            tell(f"waiting for the operator to type {laser.challenge}; the box: {proof}")
            watched = f"{laser.switches.sentence()}. The box: {proof}"
            self._code = self._operator.confirmation_code(laser.challenge, watched)
            laser.warm(order.rate_hz)
            self._wait_until_warm(laser, order.warm_up_s, tell)
        laser.set(order.timing, self.exposures)
        return laser

    def fire(self, laser: Laser, pairs: int, armed: Callable[[], bool]) -> LaserSupervisor:
        """Arm and fire one chunk; return the watch over it, to be entered.

        Parameters
        ----------
        laser : Laser
            Prepared.
        pairs : int
            To be fired.
        armed : callable
            Whether the camera waits for triggers; called from another thread.
        """
        laser.arm(self._conditions(armed, True), self._code)
        try:
            laser.renew(self._conditions(armed, True))
            laser.fire(pairs)
        except BaseException:
            if laser.state is LaserState.ARMED:
                laser.disarm()
            raise
        return LaserSupervisor(laser, lambda: self._conditions(armed, False), self._hardware.clock, SYSTEM_CLOCK)

    def off(self) -> None:
        """Switch everything off; what is not confirmed stays in the laser's state."""
        if self._laser is not None and self._laser.state is not LaserState.SAFE:
            with suppress(DaqError, StageError):
                self._laser.safe()

    def _wait_until_warm(self, laser: Laser, least_s: float, tell: Callable[[str], None]) -> None:
        clock = self._hardware.clock
        end_s = clock.now_s() + max(least_s, laser.warm_in_s)
        while (left_s := end_s - clock.now_s()) > 0.0 or laser.state is LaserState.WARM:
            if self._interrupts.is_end_wanted:
                raise RunInterrupted("ended on request while the laser warmed up")
            if laser.state not in (LaserState.WARM, LaserState.READY):
                break  # set() says what is wrong
            tell(f"the laser warms up, {max(0.0, left_s):.0f} s left")
            clock.sleep_s(WARM_UP_POLL_S)

    def _conditions(self, armed: Callable[[], bool], is_empty: bool) -> Conditions:
        """Read the present conditions: every axis is asked before arming, one after the other while it fires."""
        stage = self._hardware.stage
        if is_empty:
            self._where_mm = stage.where_mm()
            self._turn = cycle(self._where_mm)
        else:
            name = next(self._turn)
            self._where_mm[name] = stage.where_mm([name])[name]
        where = self._where_mm
        at_rest = all(mm is not None for mm in where.values())
        bench = self._hardware.bench
        clearance_mm = sheet_clearance_mm(bench, require_positions(where)) if at_rest else None
        height, width = bench.scene.camera.shape
        room = shutil.disk_usage(self._folder.path).free // (4 * height * width)
        return Conditions(armed(), is_empty, at_rest, clearance_mm, int(room))


def exposure_of(settings: Mapping[str, Setting]) -> float:
    """Exposure time that the camera has read back [us]; PlanError if it tells none."""
    if exposure_us := first_of(settings, EXPOSURES_US):
        return exposure_us
    raise PlanError("the camera does not report its ExposureTime, so no pulse can be placed")


def require_rate(settings: Mapping[str, Setting], frames: int, rate_hz: float) -> None:
    """Refuse more pairs a second than the camera says it can take; RunUsageError."""
    for name in RATES_HZ:
        most = settings.get(name)
        if isinstance(most, int | float) and 0 < most < frames * rate_hz:
            raise RunUsageError(
                f"{rate_hz:g} pairs/s are {frames * rate_hz:g} frames/s, and the camera can take {most:.4g} "
                f"({name}); ask for less, or shorten its exposure"
            )
