"""What happens to a laser and the stages of one bench, and the judge of it; see `light`."""

from types import SimpleNamespace
from typing import ClassVar

from daq.bench.bench_table import Bench, BenchTable
from daq.bench.opened import OpenBench
from daq.runner.laser_session import LaserSession
from daq.timing.conditions import Rules
from daq.timing.low_energy import LowEnergyRules
from daq.timing.states import LaserState
from daq.timing.supervisor import LaserSupervisor
from ground.config import Document
from sim.emulators.faults import KINDS, Fault
from stages.clock import SYSTEM_CLOCK
from tests.fuzz.benches import laser
from tests.fuzz.benches.bench import AXES, KEEP_OUT, SCENE, TABLE
from tests.fuzz.benches.two_threads import Other

CLEAR_MM = 4.0
SLACK_MM = 0.25  # what the workshop built: play, lead, tolerance of arrival
BALL_MM, BALL_RADIUS_MM, THICK_MM = 25.0, 10.0, 5.0  # of the ball at home; of the target
CONTROLLERS = ("glass", "target", "target", "portal", "rail")
WEAK = LowEnergyRules(q_switch_delay_us=300.0, pulse_us=5.0)
RULES = Rules(warmup_s=5.0, clear_mm=CLEAR_MM, uncounted=True, align=WEAK)
READY_BY_HAND = 0.7  # of the stories begin with a laser that may be armed
LONGEST_S = 600.0  # of three reference runs in a row, of which each may take home_timeout_s


def bench_of(scene):
    """The bench file of this bench."""
    table = {
        "name": "fuzz", "scene": "fuzz.yaml", "stages": TABLE.model_dump(exclude_unset=True),
        "glass": {"out_mm": {"glass_x": -40.0}}, "camera": {"backend": "none"}, "keep_out": KEEP_OUT.model_dump(),
    }  # fmt: skip
    return Bench(None, Document(None, {}, {}), BenchTable.model_validate(table), scene)


class LightStory(laser.Story):
    """One laser on one bench, and what happens to both.

    Parameters
    ----------
    seed : str
        Of everything.
    bench : FuzzBench
        Homed; it is used up.
    glides : list
        Gets (begin_s, end_s, axis) of every motion.
    """

    def __init__(self, seed, bench, glides):
        super().__init__(seed, bench.clock)
        self.laser.rules = RULES
        self.bench, self.glides, self.stage = bench, glides, bench.stage
        self.laser.add_motion_interlock(self.stage)
        hardware = OpenBench(bench_of(SCENE), {"stages": self.stage}, {}, bench.clock, None)
        self.light = LaserSession(hardware, SimpleNamespace(path="."), None, None)
        self.supervisor = None
        self.lit_s = []  # when something was lit
        self.lit = self.moves = 0

    def judge(self, pulse):
        super().judge(pulse)
        if pulse.output not in self.q_switches or self.is_mixed_by_keys(pulse):
            return
        self.lit_s.append(pulse.rises_s)
        if self.laser._state is LaserState.ALIGNING:  # to see the sheet on what stands in it
            return
        true_mm = self.bench.world.true_mm
        ball_mm = abs(BALL_MM + true_mm("glass_z")) - BALL_RADIUS_MM
        front_mm = true_mm("target_z")
        target_mm = -front_mm if front_mm <= 0.0 else front_mm - THICK_MM
        for name, clear_mm in (("the ball", ball_mm), ("the target", target_mm)):
            if clear_mm < CLEAR_MM - SLACK_MM:
                self.found.append(f"a pulse at {pulse.rises_s:.4f} s with {name} {clear_mm:.2f} mm off the sheet")

    def judge_motion(self):
        """Whether something moved when something was lit, since this was last asked."""
        for line in self.bench.lines.values():
            line.emulator.advance()
        for at_s in self.lit_s:
            for begin_s, end_s, axis in self.glides:
                if begin_s < at_s < end_s:
                    self.found.append(f"a pulse at {at_s:.4f} s while {axis} moves")
        self.lit += len(self.lit_s)
        now_s = self.clock.now_s()
        self.lit_s.clear()
        self.glides[:] = [glide for glide in self.glides if glide[1] > now_s - 0.1]

    # ---- the laser, as a run uses it --------------------------------------------------------------------

    def conditions(self):
        is_armed = self.rng.random() < 0.9
        return self.light._conditions(lambda: is_armed, True)

    def arm(self):
        code = self.laser.challenge if self.rng.random() < 0.95 else "code"
        conditions = self.conditions()
        self.sometimes_nudge()
        self.laser.arm(conditions, code)

    def fire(self):
        self.laser.renew(self.conditions())
        super().fire()
        self.light._conditions(lambda: True, True)
        self.supervisor = LaserSupervisor(
            self.laser, lambda: self.light._conditions(lambda: True, False), self.clock, SYSTEM_CLOCK
        )

    def chunk(self):
        """Arm and fire as a run does."""
        pairs = self.rng.choice((3, 20, 50))
        if self.laser.state is LaserState.READY:
            self.asked_for(pairs)
            if laser.PERSON_AS_IT_FIRES and self.rng.random() < laser.PERSON_AS_IT_FIRES:
                self.person_at_any_byte(140)
        self.light._code = self.laser.challenge
        self.sometimes_nudge()
        self.supervisor = self.light.fire(self.laser, pairs, lambda: True)
        self.watch()

    def watch(self):
        """The supervisor takes some steps."""
        for _ in range(self.rng.choice((1, 10, 60))):
            if self.supervisor is None:
                return
            if self.laser.state is not LaserState.FIRING:
                self.laser.confirm_off()  # as its second thread does
                return
            self.supervisor.ask()
            self.supervisor.judge()
            self.clock.sleep_s(0.01)

    # ---- the stages ------------------------------------------------------------------------------------

    def begin_other(self, work):
        """The other thread does something; it gets as far as its first sleep."""
        if self.clock.other is not None and not self.clock.other.has_ended:
            return
        self.moves += 1
        other = Other(self.clock, work)
        if self.rng.random() < 0.7:
            other.run()

    def targets(self):
        names = self.rng.sample(["target_z", "glass_z", *AXES], self.rng.choice((1, 1, 2)))
        return {name: round(self.rng.uniform(*AXES[name]["limits_mm"]), 2) for name in names}

    def move(self):
        targets = self.targets()
        self.begin_other(lambda: self.stage.move(targets))

    def move_one(self):
        (axis, target_mm), *_ = self.targets().items()
        self.begin_other(lambda: self.stage.axis(axis).move_to(target_mm))

    def home(self):
        controller = self.rng.choice(CONTROLLERS)
        names = [axis for axis, table in AXES.items() if table["controller"] == controller]
        self.begin_other(lambda: self.stage.home(names if self.rng.random() < 0.7 else None))

    def rest(self):
        """Until the other thread has ended; an answer that is lost ends a reference run by its own time alone."""
        for _ in range(round(LONGEST_S / 0.5)):
            if self.clock.other is None or self.clock.other.has_ended:
                return
            self.clock.sleep_s(0.5)

    def clear_sheet(self):
        """Put ball and target where light may leave; this thread waits for it."""
        self.rest()
        self.stage.clear_stop()
        for name, box in self.stage.controllers.items():
            if box.is_lost:
                self.bench.lines[name].plug_in()
                self.stage.connect(name)
        if any(mm is None for mm in self.stage.where_mm().values()):
            self.begin_other(lambda: self.stage.home())
            self.rest()
        self.begin_other(lambda: self.stage.move({"target_z": -15.0, "glass_z": 0.0}))
        self.rest()

    def sometimes_nudge(self):
        if self.rng.random() < 0.5:
            self.nudge_at_any_byte()

    def nudge_at_any_byte(self):
        """The other thread goes on, or begins to move something, between two bytes to the timing unit."""
        targets = self.targets()

        def nudge():
            other = self.clock.other
            if other is not None and other.is_here:
                return
            if other is None or other.has_ended:
                self.moves += 1
                other = Other(self.clock, lambda: self.stage.move(targets))
            other.run()

        self.line.hooks.press(
            self.rng.randrange(1, 40), self.rng.choice(("write", "answer")), nudge, lambda: False
        )

    def stage_fault(self):
        line = self.bench.lines[self.rng.choice(CONTROLLERS)]
        fault = Fault(self.rng.choice(KINDS[:-1]), 0, delay_s=self.rng.choice((0.01, 0.7, 2.0)))
        if self.rng.random() < 0.3:
            line.faults.strike(fault)
        else:
            number = self.rng.randrange(1, 60)
            line.hooks.after(number, "answer", lambda: line.faults.strike(fault))

    def stage_power(self):
        line = self.bench.lines[self.rng.choice(CONTROLLERS)]
        off_s = self.rng.choice((0.0, 0.1, 0.5))
        self.at_some_byte(line, lambda: line.power_cycle(off_s))

    def stage_unplug(self):
        line = self.bench.lines[self.rng.choice(CONTROLLERS)]
        self.at_some_byte(line, line.unplug)

    def at_some_byte(self, line, action):
        if self.rng.random() < 0.3:
            action()
        else:
            line.hooks.after(self.rng.randrange(1, 120), "byte", action)

    def stage_plug(self):
        name = self.rng.choice(CONTROLLERS)
        self.rest()
        self.bench.lines[name].plug_in()
        self.stage.connect(name)

    def stage_stop(self):
        self.stage.stop_quietly()

    def stage_clear(self):
        self.bench.world.witness.note_clear()
        self.stage.clear_stop()

    VERBS: ClassVar = {
        **laser.Story.VERBS, "chunk": 12, "move": 14, "move_one": 5, "home": 3, "rest": 4, "clear_sheet": 8,
        "nudge_at_any_byte": 8, "stage_fault": 5, "stage_power": 2, "stage_unplug": 2, "stage_plug": 3,
        "stage_stop": 2, "stage_clear": 3,
    }  # fmt: skip
    USUAL: ClassVar = {
        **laser.Story.USUAL, LaserState.WARM: ("sleep", "clear_sheet"),
        LaserState.ARMED: ("fire", "fire", "move"), LaserState.ALIGNING: ("wait", "sleep", "move"),
        LaserState.FIRING: (
            "wait", "watch", "watch", "move", "home", "nudge_at_any_byte", "stage_power", "stage_fault",
            "endless",
        ),
    }  # fmt: skip

    def begin(self):
        super().begin()
        if self.rng.random() < READY_BY_HAND:
            for name in ("warm", "clear_sheet", "set"):
                self.do(name)

    def next_verb(self):
        if self.laser.state is LaserState.READY and self.laser.schedule is not None and self.rng.random() < 0.6:
            return self.rng.choice(("chunk", "clear_sheet", "move", "arm"))
        return super().next_verb()

    def do(self, name):
        super().do(name)
        self.judge_motion()

    def end(self):
        for line in self.bench.lines.values():
            line.hooks.clear()
        super().end()
        self.rest()
        self.judge_motion()
        self.found += [str(violation) for violation in self.bench.world.witness.judge()]
