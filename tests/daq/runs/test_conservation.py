"""The books of a run: every cause in its own column, and no frame hidden."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from daq.cameras.camera import Counters
from daq.runs.frame_accounting import FrameAccounting, FrameCounters

small = st.integers(0, 50)


@given(small, small, small, small, small)
def test_software_triggers_balance_whatever_happened(good, incomplete, underrun, missing, ignored):
    """A camera that counts honestly leaves nothing over, and nothing silent."""
    books = FrameCounters(software=True)
    books.triggers = good + incomplete + underrun + missing + ignored
    books.handed = good
    books.timeouts = incomplete + missing + ignored
    accounting = books.close(Counters(good, incomplete, underrun, missing, ignored_triggers=ignored))
    assert accounting.imbalance == 0
    assert accounting.silent == 0
    assert accounting.losses == underrun + missing + ignored


@given(small, st.integers(1, 5), st.integers(0, 5))
def test_silence_is_believed_only_as_often_as_we_waited_in_vain(good, gone, waited):
    books = FrameCounters(software=True)
    books.triggers, books.handed, books.timeouts = good + gone, good, waited
    accounting = books.close(Counters(good, ignored_triggers=0))
    assert accounting.silent == min(gone, waited)
    assert accounting.imbalance == max(0, gone - waited)


def of_arms(*arms, software=False, **counts):
    """The accounting of a session of some arms."""
    books = FrameCounters(software)
    for name, value in counts.items():
        setattr(books, name, value)
    for counters in arms:
        accounting = books.close(counters)
    assert accounting == books.accounting()
    return accounting


def test_a_stream_is_counted_by_the_camera_and_checked_against_us():
    accounting = of_arms(Counters(12, 1, 3, 4), handed=10, rejected=2)
    assert (accounting.triggered, accounting.imbalance) == (20, 0)
    assert of_arms(Counters(13), handed=10, rejected=2).imbalance == 1  # one was delivered and went nowhere
    surplus = of_arms(Counters(12, unused=2), handed=10, rejected=2)
    assert (surplus.rejected, surplus.losses, surplus.imbalance) == (4, 0, 0)


@pytest.mark.parametrize("told", ["in_doubt", "by_time"])
def test_a_camera_that_forgot_its_settings_may_expose_unasked(told):
    arm, sent = Counters(3, underrun=2, ignored_triggers=0), {"software": True, "triggers": 3, "handed": 3}
    assert of_arms(arm, **sent).imbalance == -2  # nobody said so: the books do not balance
    accounting = of_arms(arm, **sent, **{told: True})
    assert (accounting.triggered, accounting.imbalance) == (5, 0)


def test_a_frame_that_comes_in_the_next_arm_is_no_longer_silent():
    """Alone, the first arm has one silent trigger and the second one frame too many."""
    sent = {"software": True, "triggers": 2, "handed": 1, "timeouts": 1}
    silent = of_arms(Counters(), Counters(1), **sent)
    late = of_arms(Counters(), Counters(2), **sent, rejected=1)
    assert (silent.silent, silent.rejected, silent.imbalance) == (1, 0, 0)
    assert (late.silent, late.rejected, late.imbalance) == (0, 1, 0)


def test_a_frame_of_an_earlier_process_hides_no_silent_trigger():
    accounting = of_arms(Counters(1), software=True, triggers=1, timeouts=1, rejected=1, unasked=1)
    assert (accounting.triggered, accounting.rejected, accounting.silent, accounting.imbalance) == (2, 1, 1, 0)


def test_ledgers_add_and_travel():
    total = FrameAccounting(triggered=3, written=2, silent=1) + FrameAccounting(triggered=1, incomplete=1)
    assert (total.triggered, total.losses, total.imbalance) == (4, 1, 0)
    assert FrameAccounting.from_dict(total.to_dict()) == total
    assert total.sentence() == "4 triggered = 2 written + 1 incomplete + 1 lost"
    assert FrameAccounting(triggered=3, written=3).sentence() == "3 triggered = 3 written"
    assert (
        FrameAccounting(triggered=3, written=2, rejected=2).sentence() == "3 triggered != 2 written + 2 rejected"
    )
    assert FrameAccounting(triggered=0, written=0).sentence() == "no frame triggered yet"
    assert "!=" in FrameAccounting(triggered=1).sentence()


@pytest.mark.parametrize("unwritten", [0, 3])
def test_what_the_disk_did_not_take_is_lost(unwritten):
    accounting = FrameAccounting(triggered=5, written=5 - unwritten, unwritten=unwritten)
    assert accounting.imbalance == 0
    assert accounting.losses == unwritten
