"""What a journal says about doubt; the sums are judged with the runs that make them."""

from daq.runs.frame_accounting import FrameAccounting, ambiguities


def counts(accounting, **more):
    return {"kind": "counts", "books": accounting.to_dict(), "flow": {}, **more}


def test_a_run_without_doubt():
    whole = counts(FrameAccounting(triggered=3, written=2, silent=1))
    assert ambiguities([]) == []
    assert ambiguities([{"kind": "session"}, whole, {"kind": "end", "why": "finished", "error": ""}]) == []


def test_books_that_do_not_balance_are_a_doubt_whatever_followed():
    wrong, whole = counts(FrameAccounting(triggered=2, written=3)), counts(FrameAccounting(triggered=3, written=3))
    (said,) = ambiguities([wrong, {"kind": "session"}, whole])
    assert "2 triggered != 3 written" in said


def test_what_a_session_said_is_told_once():
    text = "a frame cannot be given to its trigger"
    first, end = {"kind": "doubt", "doubt": text}, {"kind": "end", "doubt": text}
    assert ambiguities([first, counts(FrameAccounting(triggered=1), doubt=text), end]) == [text]
    assert ambiguities([first]) == [text]  # killed right after
