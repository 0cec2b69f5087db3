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


def test_a_stream_is_counted_by_the_camera_and_checked_against_us():
    books = Bookkeeper(software=False)
    books.handed, books.rejected = 10, 2
    assert books.close(Counters(12, 1, 3, 4)).imbalance == 0
    assert books.close(Counters(12, 1, 3, 4)).triggered == 20
    assert books.close(Counters(13)).imbalance == 1  # one that was delivered and went nowhere


def test_a_camera_that_forgot_its_settings_may_expose_unasked():
    books = Bookkeeper(software=True)
    books.triggers = books.handed = 3
    counters = Counters(3, underrun=2, ignored_triggers=0)
    assert books.close(counters).imbalance == -2  # nobody said so: the books do not balance
    books.in_doubt = True
    assert books.close(counters).imbalance == 0
    assert books.close(counters).triggered == 5


def test_ledgers_add_and_travel():
    total = Ledger(triggered=3, written=2, silent=1) + Ledger(triggered=1, incomplete=1)
    assert (total.triggered, total.lost, total.imbalance) == (4, 1, 0)
    assert Ledger.from_dict(total.to_dict()) == total
    assert total.sentence() == "4 triggered = 2 written + 1 incomplete + 0 rejected + 1 lost"
    assert "!=" in Ledger(triggered=1).sentence()


@pytest.mark.parametrize("unwritten", [0, 3])
def test_what_the_disk_did_not_take_is_lost(unwritten):
    ledger = Ledger(triggered=5, written=5 - unwritten, unwritten=unwritten)
    assert ledger.imbalance == 0
    assert ledger.lost == unwritten
