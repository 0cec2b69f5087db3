"""The books of a run: every cause in its own column, and no frame hidden."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from daq.cameras.camera import Counters
from daq.runs.conservation import Bookkeeper, Ledger

small = st.integers(0, 50)


@given(small, small, small, small, small)
def test_software_triggers_balance_whatever_happened(good, incomplete, underrun, missing, ignored):
    """A camera that counts honestly leaves nothing over, and nothing silent."""
    books = Bookkeeper(software=True)
    books.triggers = good + incomplete + underrun + missing + ignored
    books.handed = good
    books.timeouts = incomplete + missing + ignored
    ledger = books.close(Counters(good, incomplete, underrun, missing, ignored_triggers=ignored))
    assert ledger.imbalance == 0
    assert ledger.silent == 0
    assert ledger.lost == underrun + missing + ignored


@given(small, st.integers(1, 5), st.integers(0, 5))
def test_silence_is_believed_only_as_often_as_we_waited_in_vain(good, gone, waited):
    books = Bookkeeper(software=True)
    books.triggers, books.handed, books.timeouts = good + gone, good, waited
    ledger = books.close(Counters(good, ignored_triggers=0))
    assert ledger.silent == min(gone, waited)
    assert ledger.imbalance == max(0, gone - waited)


def of_arms(*arms, software=False, **counts):
    """The ledger of a session of some arms."""
    books = Bookkeeper(software)
    for name, value in counts.items():
        setattr(books, name, value)
    for counters in arms:
        ledger = books.close(counters)
    assert ledger == books.ledger()
    return ledger


def test_a_stream_is_counted_by_the_camera_and_checked_against_us():
    ledger = of_arms(Counters(12, 1, 3, 4), handed=10, rejected=2)
    assert (ledger.triggered, ledger.imbalance) == (20, 0)
    assert of_arms(Counters(13), handed=10, rejected=2).imbalance == 1  # one was delivered and went nowhere
    surplus = of_arms(Counters(12, unused=2), handed=10, rejected=2)
    assert (surplus.rejected, surplus.lost, surplus.imbalance) == (4, 0, 0)


@pytest.mark.parametrize("told", ["in_doubt", "by_time"])
def test_a_camera_that_forgot_its_settings_may_expose_unasked(told):
    arm, sent = Counters(3, underrun=2, ignored_triggers=0), {"software": True, "triggers": 3, "handed": 3}
    assert of_arms(arm, **sent).imbalance == -2  # nobody said so: the books do not balance
    ledger = of_arms(arm, **sent, **{told: True})
    assert (ledger.triggered, ledger.imbalance) == (5, 0)


def test_a_frame_that_comes_in_the_next_arm_is_no_longer_silent():
    """Alone, the first arm has one silent trigger and the second one frame too many."""
    sent = {"software": True, "triggers": 2, "handed": 1, "timeouts": 1}
    silent = of_arms(Counters(), Counters(1), **sent)
    late = of_arms(Counters(), Counters(2), **sent, rejected=1)
    assert (silent.silent, silent.rejected, silent.imbalance) == (1, 0, 0)
    assert (late.silent, late.rejected, late.imbalance) == (0, 1, 0)


def test_a_frame_of_an_earlier_process_hides_no_silent_trigger():
    ledger = of_arms(Counters(1), software=True, triggers=1, timeouts=1, rejected=1, unasked=1)
    assert (ledger.triggered, ledger.rejected, ledger.silent, ledger.imbalance) == (2, 1, 1, 0)


def test_ledgers_add_and_travel():
    total = Ledger(triggered=3, written=2, silent=1) + Ledger(triggered=1, incomplete=1)
    assert (total.triggered, total.lost, total.imbalance) == (4, 1, 0)
    assert Ledger.from_dict(total.to_dict()) == total
    assert total.sentence() == "4 triggered = 2 written + 1 incomplete + 1 lost"
    assert Ledger(triggered=3, written=3).sentence() == "3 triggered = 3 written"
    assert Ledger(triggered=3, written=2, rejected=2).sentence() == "3 triggered != 2 written + 2 rejected"
    assert Ledger(triggered=0, written=0).sentence() == "no frame triggered yet"
    assert "!=" in Ledger(triggered=1).sentence()


@pytest.mark.parametrize("unwritten", [0, 3])
def test_what_the_disk_did_not_take_is_lost(unwritten):
    ledger = Ledger(triggered=5, written=5 - unwritten, unwritten=unwritten)
    assert ledger.imbalance == 0
    assert ledger.lost == unwritten
