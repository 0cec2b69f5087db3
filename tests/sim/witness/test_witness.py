"""The witness sees what is wrong, whatever controllers say, and holds nothing else against anybody."""

import os

import pytest

from daq.bench.keep_out import KeepOutTable
from sim.emulators.grbl import GrblEmulator
from sim.emulators.line import Line
from sim.mechanics.clock import VirtualClock
from sim.mechanics.motion import Mechanics, Motor
from sim.witness.clearances import Carried, Clearances
from sim.witness.witness import LEDGER, Watched, Witness
from tracer.bodies import Sphere
from tracer.camera import Camera, look_at
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene

SCREW = Mechanics(lead_mm=4.0, steps_per_rev=1600, high_switch_mm=100.0, power_up_mm=50.0)
PER_MM, SPEED, RAMP = 400, 4000.0, 40_000.0  # 10 mm/s in 0.1 s


class World:
    """Two motors whose firmware does nothing but to say what they run for."""

    def __init__(self, **limits_mm):
        self.clock = VirtualClock()
        self.motors = {name: Motor(SCREW) for name in "XY"}
        self.board = GrblEmulator(self.motors, self.clock)
        for motor in self.motors.values():
            motor.listener = None
        self.line = Line(self.board, self.clock)
        self.line.open(self)
        axes = {
            name: Watched(motor, self.line, name, 1, 0.0, 0.0, limits_mm.get(name, (10.0, 90.0)), 0.1)
            for name, motor in self.motors.items()
        }
        self.witness = Witness(axes, self.clock)
        self.axes = axes

    def go(self, wait_s=20.0, **to_mm):
        self.board.advance()
        for name, at_mm in to_mm.items():
            motor = self.motors[name]
            way_mm = at_mm - motor.carriage_mm
            motor.go(motor.steps + way_mm * PER_MM, SPEED, RAMP)
        self.clock.sleep_s(wait_s)
        self.board.advance()

    def kinds(self):
        return [(violation.kind, violation.what) for violation in self.witness.judge()]


def test_limits_are_limits_of_the_carriage():
    world = World()
    world.go(X=90.09, Y=10.0)
    assert not world.kinds()
    world.go(X=90.3)
    assert world.kinds() == [("limit", "X")]
    found = world.witness.violations[0]
    assert found.depth_mm == pytest.approx(0.2, abs=0.01)
    assert "truly at 90.3" in str(found)


def test_back_from_outside_the_limits_is_allowed_and_further_out_is_not():
    world = World(X=(10.0, 40.0))  # 10 mm outside from the beginning
    world.go(X=45.0)
    world.go(X=39.0)
    assert not world.kinds()
    world = World(X=(10.0, 40.0))
    world.go(X=51.0)
    assert world.kinds() == [("limit", "X")]


def test_a_reference_run_is_not_judged_and_the_next_motion_is():
    world = World()
    world.board._state = "Home"
    world.go(X=95.0)
    assert not world.kinds()
    world.board._state = "Idle"
    world.go(X=94.0)
    assert not world.kinds()
    world.go(X=95.0)
    assert world.kinds() == [("limit", "X")]


def test_the_braking_way_of_a_reference_run_belongs_to_it():
    world = World()
    world.board._state = "Home"
    world.go(wait_s=4.2, X=99.0)
    world.board._state = "Idle"
    world.motors["X"].brake(RAMP / 10)
    world.clock.sleep_s(10.0)
    assert not world.kinds()
    assert world.motors["X"].carriage_mm > 91.0
    world.go(X=99.0)
    assert world.kinds() == [("limit", "X")]


def test_a_motion_is_judged_although_the_controller_believes_to_be_elsewhere():
    world = World()
    world.board.restart()
    world.go(X=96.0)
    assert world.kinds() == [("limit", "X")]


@pytest.mark.parametrize(
    ("pressed_s", "brakes_s", "seen"), [(1.0, 1.05, False), (1.0, 1.099, False), (1.0, 1.2, True)]
)
def test_after_a_stop_a_motor_must_brake_within_100_ms(pressed_s, brakes_s, seen):
    world = World()
    world.go(wait_s=pressed_s, X=80.0)
    world.witness.note_stop()
    world.clock.sleep_s(brakes_s - pressed_s)
    world.board.advance()
    world.motors["X"].brake(RAMP / 10)  # a second to brake
    world.clock.sleep_s(30.0)
    assert world.kinds() == ([("stop", "X")] if seen else [])


@pytest.mark.parametrize("cleared", [False, True])
def test_after_a_stop_nothing_begins_until_it_is_cleared(cleared):
    world = World()
    world.go(X=60.0)
    world.witness.note_stop()
    world.clock.sleep_s(100.0)
    if cleared:
        world.witness.note_clear()
    world.go(Y=60.0)
    assert world.kinds() == ([] if cleared else [("stop", "Y")])
    world.go(X=50.0)
    assert len(world.kinds()) == (0 if cleared else 2)


def test_a_stop_ends_reference_runs_too():
    world = World()
    world.board._state = "Home"
    world.witness.note_stop()
    world.go(X=60.0)
    assert world.kinds() == [("stop", "X")]


def test_what_no_stop_can_reach_may_end_its_motion_and_begin_no_other():
    world = World()
    world.go(wait_s=1.0, X=80.0)
    world.line.unplug()
    world.witness.note_stop()
    world.clock.sleep_s(20.0)
    assert not world.kinds()
    world.go(X=70.0)
    assert world.kinds() == [("stop", "X")]


@pytest.mark.parametrize(("after_s", "seen"), [(0.05, False), (0.2, True)])
def test_a_plug_that_is_pulled_in_the_moment_of_a_stop_may_keep_it_away(after_s, seen):
    world = World()
    world.go(wait_s=1.0, X=80.0)
    world.witness.note_stop()
    world.clock.sleep_s(after_s)
    world.line.unplug()
    world.clock.sleep_s(20.0)
    assert bool(world.kinds()) is seen


def test_a_position_that_is_told_is_compared_with_the_carriage():
    world = World()
    world.go(X=60.0)
    world.witness.check_report("X", 60.09)
    assert not world.kinds()
    world.witness.check_report("X", 60.4)
    assert world.kinds() == [("told", "X")]
    assert "is at 60.000 mm" in str(world.witness.violations[0])


def test_a_slip_is_forgiven_until_the_axis_is_homed():
    world = World()
    world.motors["X"].slip(3.0)
    world.witness.note_slip("X", 3.0)
    world.witness.check_report("X", 50.0)
    world.go(X=92.0)
    assert not world.kinds()
    world.board._state = "Home"
    world.go(X=60.0)
    world.board._state = "Idle"
    world.witness.judge()
    world.witness.check_report("X", 57.0)
    assert world.kinds() == [("told", "X")]


def test_a_shove_by_hand_is_nobodys_motion_and_moves_the_truth():
    world = World()
    world.witness.note_stop()
    world.motors["X"].shove(round(45.0 * PER_MM))
    world.clock.sleep_s(1.0)
    assert not world.kinds()
    assert world.motors["X"].carriage_mm == pytest.approx(95.0)
    assert world.motors["X"].encoder_steps == 45 * PER_MM
    assert world.motors["X"].steps == 0
    world.witness.note_clear()
    world.go(X=96.0)
    assert world.kinds() == [("limit", "X")]


def in_a_scene(world):
    camera = Camera(6000.0, (9.5, 9.5), (20, 20), (0.0, 0.0, 500.0), look_at((0.0, 0.0, 500.0), (0.0, 0.0, 0.0)))
    ball = Sphere("ball", (0.0, 0.0, 50.0), 20.0, ConstantMedium(1.5, "glass"))
    table = KeepOutTable(
        clearance_mm=5.0,
        target_size_mm=[100.0, 100.0, 10.0],
        camera_radius_mm=10.0,
        camera_ahead_mm=10.0,
        camera_behind_mm=10.0,
    )
    carried = {"X": Carried("glass", 2, 50.0), "Y": Carried("target", 2, 50.0)}
    world.witness._clearances = Clearances(Scene(camera, (ball,)), carried, table, {"X": 0.1, "Y": 0.1})
    return world


def test_two_axes_at_once_are_judged_where_they_are_together():
    """The ball stands 30 mm before the target; each alone may go 20 mm, together 5 mm are left after 12.5 mm."""
    world = in_a_scene(World())
    world.go(X=30.0)
    world.go(X=50.0)
    world.go(Y=70.0)
    world.go(Y=50.0)
    assert not world.kinds()
    world.go(X=30.0, Y=70.0)
    assert world.kinds()[0] == ("keep-out", "ball and the target")
    first = world.witness.violations[0]
    assert first.time_s - 80.0 == pytest.approx(1.35, abs=0.05)  # 12.5 mm at 10 mm/s, and a ramp of 0.1 s


def test_two_axes_that_pass_each_other_at_different_times_are_not_taken_for_a_meeting():
    world = in_a_scene(World())
    world.go(wait_s=5.0, X=30.0)
    world.go(wait_s=5.0, X=50.0)
    world.go(wait_s=0.5, X=70.0)
    world.go(Y=70.0)  # behind the ball that goes away
    assert not world.kinds()


def test_looking_often_and_looking_once_see_the_same():
    depths = []
    for looks in (1, 997):
        world = in_a_scene(World())
        world.go(wait_s=0.0, X=26.0, Y=55.0)
        for _ in range(looks):
            world.clock.sleep_s(20.0 / looks)
            world.board.advance()
            if looks > 1:
                world.witness.judge()
        world.witness.judge()
        depths.append(max(violation.depth_mm for violation in world.witness.violations))
    assert depths[0] == pytest.approx(depths[1], rel=0.4)
    assert depths[0] == pytest.approx(30.0 - 24.0 - 5.0 - 5.0 + 9.0 - 0.2, abs=4.0)


def test_every_process_writes_what_it_sees(tmp_path, monkeypatch):
    monkeypatch.setenv(LEDGER, str(tmp_path))
    world = World()
    world.go(X=95.0)
    world.witness.judge()
    assert (tmp_path / f"{os.getpid()}.txt").read_text().startswith("limit of X at")
