"""Results written behind: in their order, one at a time, and a failure ends what was to come."""

import threading

import pytest

from rtpiv.verbs.correct import write_behind


def test_all_is_done_in_its_order_by_another_thread():
    done = []
    with write_behind() as write:
        for number in range(20):
            write(lambda number=number: done.append((number, threading.current_thread().name)))
    assert [number for number, _ in done] == list(range(20))
    assert threading.current_thread().name not in {name for _, name in done}


def test_only_one_waits_while_the_next_is_made():
    let_go, began = threading.Event(), []

    def wait(number):
        began.append(number)
        assert let_go.wait(30.0)

    with write_behind() as write:
        write(lambda: wait(0))
        second = threading.Thread(target=write, args=(lambda: wait(1),))
        second.start()
        second.join(0.2)
        assert second.is_alive()  # it holds no more than one
        let_go.set()
        second.join(30.0)
    assert began == [0, 1]


@pytest.mark.parametrize("later", [0, 1])
def test_a_failure_is_raised_and_nothing_more_begins(later):
    done = []

    def fail():
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"), write_behind() as write:  # noqa: PT012 - the block raises
        write(fail)
        for _ in range(later):
            write(lambda: done.append(1))
    assert done == []


def test_another_error_is_told_after_what_has_begun_is_whole():
    done = []
    with pytest.raises(ZeroDivisionError), write_behind() as write:  # noqa: PT012 - the block raises
        write(lambda: done.append(1))
        raise ZeroDivisionError
    assert done == [1]
