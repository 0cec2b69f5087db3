"""Servos hunt at rest and encoders show it; that is no motion, no damaged answer and no lost reference."""

import pytest

from stages.drivers_by_name import DRIVERS, FOREIGN
from stages.errors import MotionStopped, NotReferenced, StageUsageError
from tests.slow_cases import slow

pytestmark = pytest.mark.filterwarnings("ignore:.* is moved by:RuntimeWarning")
KINDS = [kind for kind in (*DRIVERS, *FOREIGN) if kind != "by_hand"]
STEPS_PER_MM = 3200.0  # 0.3 um, as a screw of 4 mm with 12 800 steps has
MOVES = 15


@pytest.fixture
def noisy(bench):
    """A bench of a kind whose readings flicker by so many steps."""

    def make(kind, noise_steps, **changes):
        scale = {"steps_per_mm": STEPS_PER_MM} if kind in ("zaber_ascii", "thorlabs_apt", "isel_dnc") else {}
        speed = {"speed_mm_s": 2.5, "approach": {"side": "from_below", "distance_mm": 0.3, "speed_mm_s": 1.0}}
        sim = {"steps_per_rev": round(4.0 * STEPS_PER_MM), "noise_steps": noise_steps}
        firmware = {"grbl": {"settings": {100: STEPS_PER_MM, 101: STEPS_PER_MM}}}.get(kind)
        return bench(kind, sim=sim, firmware=firmware, **scale, **speed, **changes)

    return make


@pytest.mark.parametrize("box", KINDS)
@pytest.mark.parametrize("noise_steps", [slow(1), slow(2), slow(5), slow(10), 20])
def test_every_move_arrives(noisy, box, noise_steps):
    made = noisy(box, noise_steps).homed()
    for number in range(MOVES):
        target_mm = 40.0 + 0.37 * (number * 7 % 11)
        made.stage.move({"a": target_mm})
        assert made.stage.where_mm()["a"] == pytest.approx(target_mm, abs=0.01 + noise_steps / STEPS_PER_MM)


@pytest.mark.parametrize("box", ["zaber_ascii", "pi_gcs2", "thorlabs_apt", "grbl"])
def test_a_stop_at_the_box_ends_the_move_of_a_noisy_stage(noisy, box):
    made = noisy(box, 20).homed({"a": 40.0})
    made.clock.at(made.clock.now_s() + 0.5, made.line.emulator.person_stops)
    with pytest.raises(MotionStopped):
        made.stage.move({"a": 45.0})
    with pytest.raises(MotionStopped, match="clear"):
        made.stage.move({"a": 41.0})


@pytest.mark.parametrize("speed_mm_s", [0.5, 2.0])
@pytest.mark.parametrize("box", ["micromanager", "positioners"])
def test_a_knob_that_is_turned_is_motion_and_a_noisy_stage_is_not(noisy, box, speed_mm_s):
    made = noisy(box, 5).homed({"a": 40.0})
    motor = made.world.motors["a"]
    assert made.stage.axis("a").position_mm == pytest.approx(40.0, abs=0.005)
    motor.go(motor.steps + 20 * STEPS_PER_MM, speed_mm_s * STEPS_PER_MM, 1e7)
    made.clock.sleep_s(0.02)
    with pytest.raises((StageUsageError, NotReferenced)):
        _ = made.stage.axis("a").position_mm
    assert motor.running


@pytest.mark.parametrize("box", ["micromanager", "positioners"])
def test_a_slowly_turned_knob_is_motion_within_the_noise(noisy, box):
    """At 40 um/s seven readings stay within 20 um and go one way."""
    made = noisy(box, 0).homed({"a": 40.0})
    motor = made.world.motors["a"]
    motor.go(motor.steps + 20 * STEPS_PER_MM, 0.04 * STEPS_PER_MM, 1e7)
    with pytest.raises(StageUsageError, match="is moving; wait until it stops"):
        _ = made.stage.axis("a").position_mm
