"""Trials of a laser's box with nothing behind its plugs: a burst of n is n, off is off, no computer is needed.

    for every plug:  find the counter there -> count bursts -> switch off in the middle of one -> pull the cable in
                     the middle of one
    a lamp's plug:   count while the lamps run -> switch off

A counter connected to one plug at a time decides, not the box. That it is on the right one is measured: a
burst of all other plugs gives nothing there, and a burst of this plug alone gives everything. That the cable is
out is measured too: the box must answer while a burst runs, and stop answering before its end. What was not
observed is neither right nor wrong, and certifies nothing.

A person has turned the key off or pulled the Q-switch plugs before this begins, so conditions of stages are not
asked for.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from math import inf
from typing import Protocol

from daq.runner.pulse_counters import Counter, Stretch
from daq.runs.laser_proof import Trial
from daq.timing.conditions import Conditions
from daq.timing.errors import LaserDoubt, NotArmed
from daq.timing.laser import Laser
from daq.timing.pulses import LAMPS, Q_SWITCHES, PairExposures, PulseTiming, Role, schedule_of
from daq.timing.states import LaserState
from stages.clock import Clock
from stages.errors import StageError

BURSTS = (1, 7, 20)
FOUND_BY, OTHERS = 3, 5  # pulses of this plug alone, and of all others
OFF_S = 0.3  # after the stop command; then no pulse may begin
# More than that between the command and the end of OFF_S: the computer was too busy to time it
SLOW_S = 0.2
CONFIRMED_S = 5.0  # until a box reads back as off
LIT_S = 1.0  # of a burst before it is switched off; of lamps
CABLE_S = 10.0  # longest burst in which a person can pull a cable
FINDING = "the counter's cable"
TRIAL_POLL_S = 0.01
LEAST_S = 5.0  # of the longest burst that a bench allows
LEAST_PAIRS = 4  # of the longest burst
BEFORE_END_S = 0.5  # of that burst, the latest at which the link may be lost
PUT_BACK_S = 60.0  # for a cable to be put back
TRIAL_ATTEMPTS = 3  # for a person to find a plug or a cable, and for a busy computer
BETWEEN_S = 0.2  # from what one stretch has to hold to the mark that ends it
PERIOD_TOLERANCE = 0.05  # share of the period by which two pulses may be off
STATED = Conditions(True, True, True, inf, 10**9)  # nothing is behind the plugs
Judge = Callable[[Stretch], Trial | None]  # of a stretch; None: nothing to report


class Helper(Protocol):
    """A person, or a simulated one; what they do is measured, not believed."""

    def promise_dark(self, challenge: str) -> str:
        """Return what was typed for the code, when no light can leave."""

    def move_counter(self, output: str, roles: str) -> None:
        """Return when the counter's cable is said to be on that output."""

    def pull_cable(self) -> None:
        """Ask for the cable between computer and box to be pulled now, and return at once."""

    def put_back(self) -> None:
        """Ask for it to be put back, and return at once."""


class BoxTrials:
    """Every trial of one box; the laser is SAFE in the end.

    Parameters
    ----------
    laser : Laser
        Open.
    timing, exposures : PulseTiming, PairExposures
        Of the bursts.
    counter, helper : Counter, Helper
        What counts, and who moves cables.
    clock : Clock
        The laser's.

    Raises
    ------
    NotArmed
        The box does not count, or the code is wrong; nothing was sent.
    """

    def __init__(
        self,
        laser: Laser,
        timing: PulseTiming,
        exposures: PairExposures,
        counter: Counter,
        helper: Helper,
        clock: Clock,
    ) -> None:
        self._laser, self._timing, self._exposures = laser, timing, exposures
        self._counter, self._helper, self._clock = counter, helper, clock
        if not laser.box.counts:
            raise NotArmed(
                f"{laser.name} cannot be proven: its box does not count pulses, so it ends no burst by itself"
            )
        if laser.rules.chunk_s < LEAST_S:
            raise NotArmed(
                f"{laser.name} is not proven: bursts of chunk_s ({laser.rules.chunk_s:g} s) end before a person "
                f"has pulled a cable; set chunk_s to {CABLE_S:g} in the bench file"
            )
        if (most := self._most(CABLE_S)) < LEAST_PAIRS:
            raise NotArmed(
                f"{laser.name} is not proven: {most} pairs fit into a burst, too few to switch it off in its "
                "middle; raise the rate, or chunk_s"
            )
        if not laser.challenge or helper.promise_dark(laser.challenge).strip() != laser.challenge:
            raise NotArmed(f"{laser.name} is not proven: type the code that it asks for ({laser.challenge})")
        laser.rules = replace(laser.rules, warmup_s=0.0)  # no trial needs a steady beam
        self.counted: tuple[str, ...] = ()  # outputs whose trials have come to their end
        self._judges: list[Judge] = []
        self._marks_s: list[tuple[float, float]] = []  # counter's clock, laser's clock

    def run(self) -> Iterator[Trial]:
        """Yield trial by trial, plug by plug.

        Raises
        ------
        TimingError, StageError, CameraError
            A trial could not be brought to its end.
        """
        for output, roles in self._plugs().items():
            name = f"{output} ({', '.join(role.value for role in roles)})"
            found = self._locate(output, roles)
            yield _with_output(name, found)
            if not found.is_right:
                continue
            has_lamp = any(role in LAMPS for role in roles)
            for trial in self._count_while(
                roles, self._run_lamps if has_lamp else partial(self._give_bursts, roles)
            ):
                yield _with_output(name, trial)
            self.counted += (output,)

    def _plugs(self) -> dict[str, list[Role]]:
        """Roles by the output where a cable hangs; both triggers of a camera come out at one."""
        wiring = self._laser.box.wiring
        plugs: dict[str, list[Role]] = {}
        for role, output in wiring.items():
            home = wiring[Role.CAMERA] if role is Role.CAMERA_B else output
            plugs.setdefault(home, []).append(role)
        return plugs

    # ---- counting --------------------------------------------------------------------------------

    def _locate(self, output: str, roles: Sequence[Role]) -> Trial:
        """Test whether the counter is connected to an output: its counts of this one alone, and of all others."""
        trial = Trial("", None, "")
        for _ in range(TRIAL_ATTEMPTS):
            self._helper.move_counter(output, ", ".join(roles))
            trials = self._count_while(roles, lambda: self._give_apart(roles))
            trial = next((trial for trial in trials if trial.is_right is False), trials[-1])
            if trial.is_right is not None:
                break
        return trial

    def _count_while(self, roles: Sequence[Role], give: Callable[[], None]) -> list[Trial]:
        """Count at one plug while pulses are given; judge every stretch once all of its pulses have arrived."""
        self._judges, self._marks_s = [_at_most("before the first burst", 0, None)], []
        schedule = schedule_of(self._timing, self._laser.head, self._exposures)
        self._counter.begin(roles, schedule.period_us, schedule.pulses[roles[0]])
        try:
            give()
            counted = self._counter.end()
        finally:
            self._counter.close()
        trials = [judge(seen) for judge, seen in zip(self._judges, counted.stretches, strict=True)]
        return [_unless(counted.trouble, trial) for trial in trials if trial is not None]

    def _next(self, judge: Judge, in_s: float = BETWEEN_S) -> None:
        """Begin a stretch, while the plug is quiet, and say how it is to be judged."""
        self._clock.sleep_s(in_s)
        self._marks_s.append((self._counter.mark(), self._clock.now_s()))
        self._judges.append(judge)

    def _exactly(self, what: str, pairs: int) -> Judge:
        """Judge a stretch that holds so many pulses, one period apart."""

        def judge(seen: Stretch) -> Trial:
            if seen.pulses != pairs:
                return Trial(what, False, _of(seen, pairs))
            period_s = 1.0 / self._timing.rate_hz * self._counter_s()
            gaps_s = [late - soon for soon, late in pairwise(seen.times_s)]
            if wrong := [gap_s for gap_s in gaps_s if abs(gap_s / period_s - 1.0) > PERIOD_TOLERANCE]:
                return Trial(
                    what, False, f"{_of(seen, pairs)}, but {wrong[0]:.4g} s apart instead of {period_s:.4g} s"
                )
            return Trial(what, True, _of(seen, pairs))

        return judge

    def _counter_s(self) -> float:
        """Seconds of the counter's clock in one of the laser's; simulated ones may run fast."""
        (counter_s, clock_s), (last_counter_s, last_clock_s) = self._marks_s[0], self._marks_s[-1]
        return (last_counter_s - counter_s) / (last_clock_s - clock_s)

    # ---- what is given ---------------------------------------------------------------------------

    def _give_apart(self, roles: Sequence[Role]) -> None:
        """Give pulses at all other plugs, then at this one alone."""
        others = [role for role in self._laser.box.wiring if role not in (*roles, *LAMPS)]
        of_others = Stretch(0.0)

        def keep(seen: Stretch) -> None:
            nonlocal of_others
            of_others = seen

        def judge(seen: Stretch) -> Trial:
            is_alone = seen.pulses > 0.0 if roles[0] in LAMPS else seen.pulses == FOUND_BY
            said = f"{seen.pulses:g} pulses of this output, {of_others.pulses:g} of {OTHERS} of all others"
            if is_alone and of_others.pulses == 0.0:
                return Trial(FINDING, True, said)
            # where nothing of this output is seen, the cable hangs elsewhere, or the output is dead
            return Trial(FINDING, False if seen.pulses > 0.0 else None, f"{said}; is the counter's cable there?")

        self._next(keep)
        self._give(others, OTHERS)
        self._next(judge)
        self._give(roles, FOUND_BY)

    def _give(self, roles: Sequence[Role], pairs: int) -> None:
        """Give pulses of some roles alone, by the box itself, while the laser is SAFE."""
        laser, box = self._laser, self._laser.box
        schedule = schedule_of(self._timing, laser.head, self._exposures)
        wiring = box.wiring
        box.wiring = {role: output for role, output in wiring.items() if role in roles}
        try:
            box.token = box.latch.begin()
            loaded = box.load(schedule.only(*box.wiring))
            if roles[0] in LAMPS:
                box.start_lamps()
            else:
                box.stand_by()
                box.confirm(loaded, lamps=False)
                box.begin(pairs)
            self._clock.sleep_s(pairs / self._timing.rate_hz + BETWEEN_S)
            if roles[0] not in LAMPS:
                box.end()
        finally:
            box.wiring = wiring
            laser.safe()

    def _give_bursts(self, roles: Sequence[Role]) -> None:
        for pairs in BURSTS:
            if pairs <= self._most(inf):
                self._next(self._exactly(f"a burst of {pairs}", pairs))
                self._fire(pairs)
                self._laser.wait()
        pairs = self._most(CABLE_S)
        self._give_and_stop("off in a burst", lambda: self._fire(pairs), range(1, pairs))
        if set(roles) & {*Q_SWITCHES, Role.CAMERA}:
            self._pull_cable(pairs)
        self._laser.safe()
        self._next(self._exactly("a burst of this output alone", FOUND_BY))  # its last pulse ends the count
        self._give(roles, FOUND_BY)

    def _run_lamps(self) -> None:
        rate_hz = self._timing.rate_hz
        least = int(self._lit_s * rate_hz) - 1
        for what in ("lamps off", "lamps off again"):
            self._give_and_stop(what, lambda: self._laser.warm(rate_hz), range(least, 2 * least + 4))
        self._next(lambda seen: None)  # the last pulses end the count
        self._give([role for role in LAMPS if role in self._laser.box.wiring], FOUND_BY)

    def _give_and_stop(self, what: str, give: Callable[[], None], expected: range) -> None:
        """Begin to give pulses, say off in the middle, and see none behind the time that this may take."""
        given = Stretch(0.0)

        def keep(seen: Stretch) -> None:
            nonlocal given
            given = seen

        for _ in range(TRIAL_ATTEMPTS):
            self._next(keep)
            give()
            self._clock.sleep_s(self._lit_s)
            stopped_s = self._clock.now_s()
            self._laser.stop("a trial")  # this word alone: what is said again comes behind the count
            self._next(_at_most(what, 0, None), stopped_s + OFF_S - self._clock.now_s())
            took_s = self._marks_s[-1][1] - stopped_s
            self._clock.sleep_s(self._lit_s)
            reads_back = self._reads_back()
            self._laser.safe()
            if took_s <= OFF_S + SLOW_S:
                break

        def judge(seen: Stretch) -> Trial:
            said = f"{given.pulses:g} pulses until {took_s:.1f} s behind the word, then {seen.pulses:g}"
            if seen.pulses:
                return Trial(what, False, f"{said}, too many")
            if not reads_back:
                return Trial(what, False, f"{said}; it does NOT read back as off")
            if given.pulses not in expected:
                return Trial(what, False, f"{said}; {expected.start} to {expected.stop - 1} were expected before")
            if took_s > OFF_S + SLOW_S:
                return Trial(what, None, f"{said}; the computer was too busy to time it, prove again")
            return Trial(what, True, said)

        self._judges[-1] = judge

    def _pull_cable(self, pairs: int) -> None:
        """Fire a burst whose cable a person pulls; once more where the link was not seen to be lost in time."""
        what = "the cable pulled in a burst"
        for _ in range(TRIAL_ATTEMPTS):
            self._next(_at_most(what, pairs, None))
            self._fire(pairs)
            end_s = self._clock.now_s() + pairs / self._timing.rate_hz
            missed = self._not_lost_by(end_s - BEFORE_END_S)
            self._clock.sleep_s(max(0.0, end_s - self._clock.now_s()) + self._lit_s)
            if not missed and self._laser.box.answers():
                missed = "the box answered again too soon; leave the cable out until you are asked to put it back"
            self._reach_again()
            if not missed:
                self._judges[-1] = self._exactly(what, pairs)
                return
        self._judges[-1] = _at_most(what, pairs, Trial(what, None, missed))

    def _not_lost_by(self, until_s: float) -> str:
        """Say why the link was not seen to be lost by then; "" if it was."""
        box = self._laser.box
        if not box.answers():
            return "the box does not answer while it fires, so a cable that is out would not be noticed"
        self._helper.pull_cable()
        while self._clock.now_s() < until_s:
            # twice: one answer may be lost on a cable that is in
            if not box.answers() and not box.answers() and self._clock.now_s() < until_s:
                return ""
            self._clock.sleep_s(TRIAL_POLL_S)
        return "the box went on answering, so the cable was not out in time; prove again, and pull it sooner"

    def _reach_again(self) -> None:
        """Ask for the cable until the box reads back as off; what hinders that is raised in the end."""
        self._helper.put_back()
        end_s = self._clock.now_s() + PUT_BACK_S
        while True:
            try:
                self._laser.safe()
                return
            except (StageError, LaserDoubt):
                if self._clock.now_s() > end_s:
                    raise
            self._clock.sleep_s(TRIAL_POLL_S)

    # ---- the laser -------------------------------------------------------------------------------

    @property
    def _lit_s(self) -> float:
        """Time for which pulses are given before off, and watched for behind it: half of a burst at most."""
        rate_hz = self._timing.rate_hz
        return min(max(LIT_S, 3.0 / rate_hz), 0.5 * self._most(CABLE_S) / rate_hz)

    def _most(self, limit_s: float) -> int:
        """Pairs of a burst that lasts so long at most."""
        return max(1, int(min(self._laser.rules.chunk_s, limit_s) * self._timing.rate_hz))

    def _fire(self, pairs: int) -> None:
        """Make ready, arm and fire."""
        laser = self._laser
        if laser.state is not LaserState.READY:
            laser.safe()
            laser.warm(self._timing.rate_hz)
            laser.set(self._timing, self._exposures)
        laser.arm(STATED, laser.challenge)  # another code since the first `safe`; the promise holds
        laser.fire(pairs)

    def _reads_back(self) -> bool:
        end_s = self._clock.now_s() + CONFIRMED_S
        while not self._laser.confirm_off() and self._clock.now_s() < end_s:
            self._clock.sleep_s(TRIAL_POLL_S)
        return self._laser.state is LaserState.FAULT


def _at_most(what: str, pulses: int, otherwise: Trial | None) -> Judge:
    """Return a judge that fails a trial of more than `pulses` pulses, and else says `otherwise`."""

    def judge(seen: Stretch) -> Trial | None:
        return Trial(what, False, _of(seen, pulses)) if seen.pulses > pulses else otherwise

    return judge


def _of(seen: Stretch, pairs: int) -> str:
    return f"{seen.pulses:g} of {pairs}{', too many' if seen.pulses > pairs else ''}"


def _unless(trouble: str, trial: Trial) -> Trial:
    """Call a trial not observed where pulses may be missing; too many are wrong all the same."""
    if not trouble or "too many" in trial.said:
        return trial
    return Trial(trial.what, None, f"{trial.said}; {trouble}")


def _with_output(plug: str, trial: Trial) -> Trial:
    return Trial(f"output {plug}: {trial.what}", trial.is_right, trial.said)
