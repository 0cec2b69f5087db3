"""A person who turns screws and reads their scales, as people do: not quite there, and not quite right.

The drum of a screw shows where its nut is; the carriage follows with the play and the errors of the screw.  The
person turns until the drum seems to stand at the place that was asked for, to within half a division.  How the
eye takes the drum is off by an error of its own each time (`reads_um`, standard deviation), so the screw is off as
well; what is typed is what the eye has seen, to the nearest division.  The error itself is hidden.

There are no bytes, and nothing to be plugged in: every question is answered (`sim.stages`).
"""

from collections.abc import Mapping

import numpy as np

from sim.emulators.device import Clock, Emulator
from sim.mechanics.motion import Motor

SPEED_MM_S, RAMP_MM_S2 = 5.0, 50.0  # a knurled knob, or a carriage that is slid along a rule


class HandScrews(Emulator):
    """The screws, and who turns them.

    Parameters
    ----------
    motors : mapping of str to Motor
        The screws by channel; what drives them is the hand.
    clock : Clock
        Time of the world.
    reads_um : float
        Standard deviation of a reading.
    division_um : float
        What is typed is a whole number of these.
    seed : int
        Of the errors.
    """

    def __init__(
        self,
        motors: Mapping[str, Motor],
        clock: Clock,
        reads_um: float = 3.0,
        division_um: float = 10.0,
        seed: int = 0,
    ) -> None:
        super().__init__(motors, clock)
        self._reads_mm, self._division_mm = reads_um * 1e-3, division_um * 1e-3
        self._errors = np.random.default_rng((seed, *(ord(letter) for letter in "".join(self.motors))))
        self.called: list[
            tuple[str, str, float]
        ] = []  # what was turned: "turn", channel, place that was asked for

    def begin(self, channel: str, target_mm: float | None) -> str:
        """Begin to turn a screw until its drum seems to show a place, or only look; return what will be typed."""
        motor = self.motors[channel]
        drum_mm = self._drum_mm(motor)
        eye_mm = float(self._errors.normal(0.0, self._reads_mm))
        if target_mm is not None:
            self.called.append(("turn", channel, target_mm))
            sets_mm = float(self._errors.uniform(-0.5, 0.5)) * self._division_mm
            turns = (target_mm + sets_mm - eye_mm - drum_mm) / motor.mechanics.lead_mm
            per_mm = motor.mechanics.steps_per_rev / motor.mechanics.lead_mm
            aim = motor.steps + round(turns * motor.mechanics.steps_per_rev)
            motor.go(aim, SPEED_MM_S * per_mm, RAMP_MM_S2 * per_mm, self.event_s)
            drum_mm += (aim - motor.steps) / per_mm
        seen = (drum_mm + eye_mm) / self._division_mm
        return f"{round(seen) * self._division_mm:.4f}"

    def let_go(self, channel: str) -> None:
        """Take the hand away."""
        self.motors[channel].halt()

    def edge(self, channel: str, name: str, upwards: bool) -> None:
        """Nothing happens at a switch: there is none, and a hand feels the end."""

    def _drum_mm(self, motor: Motor) -> float:
        """Reading of the drum, which counts turns of the screw and was set where the world begins."""
        built = motor.mechanics
        return built.power_up_mm + motor.encoder_steps * built.lead_mm / built.steps_per_rev


EMULATOR = HandScrews
