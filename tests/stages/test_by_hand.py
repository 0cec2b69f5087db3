"""Axes without a motor: what a person is asked, what is believed of the answer, and how a question ends."""

from dataclasses import replace

import pytest

from stages.config import StagesTable
from stages.errors import MotionBarred, MotionStopped, NotReferenced, OutOfRange, StageError, StageUsageError
from stages.scale_question import ScaleQuestion, place_mm
from stages.states import AxisState
from tests.stages import test_contract as contract
from tests.stages.benches import stages_table, true_errors_um

EXACT = {"reads_um": 0.0, "division_um": 1.0}


@pytest.fixture
def hands(bench):
    """Factory of benches that the simulated hand turns."""

    def make(firmware=None, **changes):
        made = bench("by_hand", firmware=EXACT if firmware is None else firmware, **changes)
        made.stage.set_operator(made.world.turns)
        return made

    return make


HELD = (
    contract.test_no_absolute_move_before_homing,
    contract.test_true_position_within_10_um_despite_50_um_backlash,
    contract.test_from_above_works_as_well,
    contract.test_without_approach_the_backlash_shows,
    contract.test_opposite_sign_and_offset_turn_the_coordinate,
    contract.test_stop_at_rest_is_harmless,
)


@pytest.mark.parametrize("holds", HELD, ids=lambda holds: holds.__name__)
def test_what_holds_of_every_axis_holds_of_hands(hands, holds):
    def of_this_kind(kind, **changes):
        return hands({**EXACT}, **changes)

    holds(of_this_kind, "by_hand")


@pytest.mark.parametrize("target_mm", [float("nan"), 4.999, 120.001])
def test_nobody_is_asked_for_what_is_out_of_range(hands, target_mm):
    made = hands()
    made.stage.home()
    with pytest.raises(OutOfRange):
        made.stage.move({"a": target_mm})
    assert made.sent == 0


def test_the_reading_is_the_position_and_its_error_is_told_to_nobody(hands):
    """A hand that reads to 20 um stands 20 um off what it says, and says whole divisions."""
    made = hands({"reads_um": 20.0, "division_um": 10.0, "seed": 4}, approach=None, backlash_um=0.0)
    made.stage.home()
    off_um = []
    for target_mm in [10.0 + 0.37 * n for n in range(60)]:
        made.stage.move({"a": target_mm})
        reads_mm = made.stage.axis("a").position_mm
        assert abs(reads_mm - target_mm) <= 0.01 + 1e-9
        assert round(100.0 * reads_mm) == pytest.approx(100.0 * reads_mm, abs=1e-6)
        off_um.append(1e3 * (made.world.true_mm("a") - reads_mm))
    sigma_um = (sum(off**2 for off in off_um) / len(off_um)) ** 0.5
    assert 15.0 < sigma_um < 26.0
    assert max(map(abs, off_um)) > 25.0


class Typist:
    """Types lines, one after the other; keeps what it was asked."""

    def __init__(self, *lines):
        self.lines, self.asked = list(lines), []

    def __call__(self, question, given_up):
        self.asked.append(question)
        return self.lines.pop(0) if self.lines else None


@pytest.fixture
def typed(bench):
    made = bench("by_hand", approach=None)

    def make(*lines):
        typist = Typist(*lines)
        made.stage.set_operator(typist)
        return made.stage, typist

    return make


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ("1O.0", "'1O.0' is no place in mm; type digits with a point, as 10.0"),
        ("10,0", "'10,0' is no place in mm"),
        ("", "nothing was typed; type what the scale of a reads, or end the run with Ctrl-C"),
        ("   ", "nothing was typed"),
        ("nan", "is no place"),
        ("1_0", "is no place"),
        ("130.0", "130 mm is outside what the scale of a may read, 5 to 120 mm"),
        ("100", "100 mm is 90.000 mm from 10.000, and 0.01 mm are allowed (in_position_um); turn a there"),
        ("10.02", "10.02 mm is 0.020 mm from 10.000"),
    ],
)
def test_what_is_no_answer_is_said_in_a_sentence_and_asked_again(typed, wrong, sentence):
    stage, typist = typed("20.0", "30.0", wrong, " 10.01 ")
    stage.home()
    stage.move({"a": 10.0})
    assert stage.where_mm() == {"a": 10.01, "b": 20.0}
    first, again = typist.asked[2:]
    assert first.words.startswith("Turn a to 10.000 mm")
    assert "What does its scale read?" in first.words
    assert again == replace(first, wrong=again.wrong)
    assert sentence in again.wrong
    assert again.words == f"{again.wrong}\n{first.words}"


def test_a_scale_that_counts_the_other_way_is_asked_for_as_it_reads(bench):
    made = bench("by_hand", approach=None, sign=-1, offset_mm=125.0)
    made.stage.set_operator(typist := Typist("100.0", "100.0", "85.0"))
    made.stage.home()
    made.stage.move({"a": 40.0})
    assert typist.asked[-1].target_mm == 85.0
    assert typist.asked[-1].limits_mm == (5.0, 120.0)
    assert made.stage.where_mm() == {"a": 40.0, "b": 25.0}


def test_nobody_answers_and_the_place_is_unknown_until_it_is_read_again(typed):
    stage, typist = typed("20.0", "30.0")
    stage.home()
    with pytest.raises(MotionStopped, match="the position of a was not read; home the axis"):
        stage.move({"a": 10.0})
    assert stage.where_mm() == {"a": None, "b": 20.0}
    assert stage.axis("a").state is AxisState.UNREFERENCED
    assert stage.what_moves() is None
    stage.clear_stop()
    with pytest.raises(NotReferenced, match="a has no position reference; home it"):
        stage.move({"a": 10.0})
    typist.lines = ["12.0", "10.0"]
    stage.home(["a"])
    stage.move({"a": 10.0})
    assert stage.where_mm() == {"a": 10.0, "b": 20.0}


def test_a_reading_at_the_very_edge_of_the_tolerance_is_one(typed):
    """1.0 - 0.99 is a little more than 0.01, in a computer."""
    stage, typist = typed("20.0", "30.0", "10.99", "12.01")
    stage.home()
    stage.move({"a": 11.0})
    stage.move({"a": 12.0})
    assert [question.wrong for question in typist.asked] == [""] * 4


def test_a_stop_ends_the_question_and_holds(hands):
    made = hands(approach=None)
    made.stage.home()
    made.clock.at(made.clock.now_s() + 2.0, made.stage.stop)
    with pytest.raises(MotionStopped):
        made.stage.move({"a": 110.0, "b": 50.0})
    rests_mm = made.world.true_mm("a"), made.world.true_mm("b")
    assert not made.world.is_moving
    made.clock.sleep_s(20.0)
    assert (made.world.true_mm("a"), made.world.true_mm("b")) == rests_mm
    assert made.stage.where_mm()["a"] is None
    with pytest.raises(MotionStopped, match="clear"):
        made.stage.home()
    made.stage.clear_stop()
    made.stage.home()
    assert max(map(abs, true_errors_um(made, (60.0,)))) <= 60.0  # the play


def test_nobody_is_there(bench):
    made = bench("by_hand")
    with pytest.raises(StageUsageError, match="b is moved by hand, and no operator is set"):
        made.stage.home()
    assert made.stage.what_moves() is None


def test_nobody_reaches_in_while_another_device_bars_it(typed):
    stage, typist = typed("20.0", "30.0", "10.0")
    stage.home()
    why = ["the laser is warm"]
    stage.bar_hands(lambda: why[0])
    with pytest.raises(MotionBarred, match="a is moved by hand, and must not be reached now: the laser is warm"):
        stage.move({"a": 10.0})
    assert len(typist.asked) == 2
    why[0] = None
    stage.home(["a"])
    assert len(typist.asked) == 3


def test_while_somebody_is_asked_something_moves(typed):
    """So no laser is armed meanwhile."""
    stage, _ = typed()
    seen = []

    def asked(question, given_up):
        seen.append(stage.what_moves())
        return "20.0"

    stage.set_operator(asked)
    stage.home()
    assert seen == ["an axis of the stage is being moved"] * 2
    assert stage.what_moves() is None


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"reading_um": None}, "axis a is moved by hand; say reading_um, the standard deviation of a reading"),
        ({"steps_per_mm": 400.0}, "axis a is moved by hand, which counts no steps"),
        ({"reading_um": 0.0}, "reading_um"),
        ({"in_position_um": 501.0}, "in_position_um"),
    ],
)
def test_an_axis_that_no_hand_can_be_is_refused(change, sentence):
    with pytest.raises(ValueError, match=sentence):
        stages_table("by_hand", **change)


def test_who_has_a_motor_has_no_scale():
    with pytest.raises(ValueError, match="axis a has a motor; reading_um is said of axes that are moved by hand"):
        stages_table("zaber_ascii", reading_um=5.0)
    assert stages_table("zaber_ascii").by_hand == {}
    assert stages_table("by_hand", in_position_um=200.0).by_hand == {"a": 3.0, "b": 3.0}


def test_hands_and_motors_stand_on_one_bench(bench):
    tree = stages_table("by_hand").model_dump(exclude_unset=True)
    tree["controllers"]["rail"] = {"driver": "isel_dnc", "port": "nowhere"}
    tree["axes"]["b"] |= {"controller": "rail", "channel": "X", "steps_per_mm": 400.0, "reading_um": None}
    assert StagesTable.model_validate(tree).by_hand == {"a": 3.0}


def test_places():
    assert place_mm(" +10.25 ") == 10.25
    assert [place_mm(text) for text in ("1e3", "", "--1", "10.", "1000000")] == [None] * 5
    question = ScaleQuestion("a", None, (0.0, 25.0), 0.01)
    assert "What does its scale read?" in question.words
    assert "Turn" not in question.words
    assert question.reading_error("25.0") is None
    assert question.reading_error("0") is None


def test_a_question_that_raises_leaves_nothing_behind(typed):
    stage, _ = typed()

    def broken(question, given_up):
        raise StageError("the window has gone")

    stage.set_operator(broken)
    with pytest.raises(StageError, match="window"):
        stage.home()
    assert stage.what_moves() is None
    assert stage.where_mm() == {"a": None, "b": None}
