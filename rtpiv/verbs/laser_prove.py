"""Proof of a timing unit (`rtpiv laser prove`): pulses at each output, counted and kept beside the bench file."""

import getpass
import platform
from typing import TYPE_CHECKING, cast

from daq.bench.opened import OpenBench
from daq.errors import DaqError, RunUsageError
from daq.plans.pulse_order import pair_exposures
from daq.runner.laser_session import exposure_of
from daq.runner.laser_trials import BoxTrials, Helper
from daq.runner.pulse_counters import BoxCounter, CameraCounter, Counter
from daq.runs.journal import utc_now
from daq.runs.laser_proof import Proof, Trial, proof_path, withdraw_proof, write_proof
from daq.timing.drivers.pulse_box import PulseBox
from daq.timing.errors import LaserDoubt
from daq.timing.laser import Laser
from daq.timing.pulses import PulseTiming
from ground.terminal import console, error_console
from stages.errors import StageError

if TYPE_CHECKING:
    from sim.bench import SimulatedBench

USUAL_DT_US = 100.0


def prove_box(hardware: OpenBench, name: str, laser: Laser, rate_hz: float) -> None:
    """Try a laser's box with nothing behind its plugs; print and keep what was counted.

    Parameters
    ----------
    hardware : OpenBench
        With the laser and the camera connected to its box.
    name : str
        Device of the bench.
    laser : Laser
        The laser.
    rate_hz : float
        Of the bursts, where its lamps do not know one rate only.

    Raises
    ------
    RunUsageError
        The bench has no camera that takes pairs.
    LaserDoubt
        Something is not right, or was not seen; the proof says what.
    """
    section = hardware.camera_section
    if section.pairs is None:
        raise RunUsageError(
            "pulses are placed into the exposures of the camera; specify how it takes pairs (camera.pairs)"
        )
    simulation = cast("SimulatedBench | None", hardware.simulation)
    helper: Helper = _Person() if simulation is None else _SimulatedPerson(simulation)
    camera = CameraCounter(hardware.camera, section)
    boxes = [device for device in hardware.devices.values() if isinstance(device, PulseBox)]
    counter: Counter = BoxCounter(boxes[0]) if boxes else camera
    exposures = pair_exposures(section.pairs, exposure_of(camera.settings))
    low_us, high_us = exposures.dt_range_us
    dt_us = min(max(low_us, laser.head.min_dt_us, USUAL_DT_US), high_us, laser.head.max_dt_us)
    timing = PulseTiming(dt_us, laser.head.lamp_rate_hz or rate_hz)
    trials = BoxTrials(laser, timing, exposures, counter, helper, hardware.clock)
    path = proof_path(hardware.bench.path, name)
    withdraw_proof(path)
    seen: list[Trial] = []
    try:
        for trial in trials.run():
            seen.append(trial)
            word = {True: "ok", False: "NOT RIGHT", None: "not observed"}[trial.is_right]
            console().print(f"{trial.what}: {word} ({trial.said})", soft_wrap=True)
    except (DaqError, StageError) as error:
        seen.append(Trial("the trials", False, f"ended by an error: {error}"))
        raise
    finally:
        channels = {role.value: output for role, output in laser.box.wiring.items()}
        who = f"{getpass.getuser()} on {platform.node()}"
        identity, is_simulated = laser.box.identity, simulation is not None
        proof = Proof(identity, channels, is_simulated, who, utc_now(), tuple(seen), trials.counted)
        write_proof(path, proof)
        console().print(f"kept in {path}", soft_wrap=True)
    if not proof.holds:
        raise LaserDoubt(f"{name} is not proven: {proof.failures[0]}")


class _Person:
    """User at the terminal."""

    def promise_dark(self, challenge: str) -> str:
        """Ask whether no light can leave."""
        return _ask(
            "Turn the laser's key off, or pull its Q-switch plugs: pulses leave the box now, and no light may.\n"
            f"Software is no interlock. Type {challenge} when no light can leave: "
        )

    def move_counter(self, output: str, roles: str) -> None:
        """Ask for it; what is counted shows whether it was done."""
        _ask(f"Put the counter's trigger cable on output {output} ({roles}) of the box, then press Enter: ")

    def pull_cable(self) -> None:
        """Ask for it."""
        error_console().print("Pull the cable between computer and box NOW.", soft_wrap=True)

    def put_back(self) -> None:
        """Ask for it."""
        error_console().print("Put the cable back.", soft_wrap=True)


class _SimulatedPerson:
    """User of a simulated bench."""

    def __init__(self, simulation: "SimulatedBench") -> None:
        self._unit = next(unit for unit in simulation.world.timing if unit.line.is_opened)
        from sim.mechanics.clock import PacedClock

        if isinstance(simulation.clock, PacedClock):
            simulation.clock.is_paced = lambda: True  # its camera is on the clock of the wall

    def promise_dark(self, challenge: str) -> str:
        """There is no light."""
        return challenge

    def move_counter(self, output: str, roles: str) -> None:
        """Move it."""
        self._unit.trigger_cable = output

    def pull_cable(self) -> None:
        """Pull it."""
        self._unit.line.unplug()

    def put_back(self) -> None:
        """Put it back."""
        self._unit.line.plug_in()


def _ask(words: str) -> str:
    error_console().print(words, end="", soft_wrap=True)
    try:
        return input()
    except EOFError:
        return ""
