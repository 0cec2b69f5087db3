"""Rows on all cores: each row once, errors out, nothing begun after an error."""

import threading

import pytest

from tracer.rows import LEAST_ROWS, run_rows


@pytest.mark.parametrize("rows", [0, 1, 7, 16, 17, 100, 2016])
@pytest.mark.parametrize("block", [None, 1, 24])
@pytest.mark.parametrize("threads", [1, 2, 5])
def test_every_row_once(rows, block, threads):
    done, lock = [0] * rows, threading.Lock()

    def work(first, last):
        assert 0 < last - first <= (block or max(LEAST_ROWS, rows))
        with lock:
            for row in range(first, last):
                done[row] += 1

    run_rows(work, rows, block, threads)
    assert done == [1] * rows


def test_long_blocks_come_first_and_none_holds_up_the_end():
    lengths = []
    run_rows(lambda first, last: lengths.append(last - first), 2016, threads=1)
    assert lengths[:-1] == sorted(lengths[:-1], reverse=True)
    assert lengths[0] <= 2016 / 3
    assert len(lengths) < 20


def test_an_error_ends_it():
    begun = []

    def work(first, last):
        begun.append(first)
        raise ValueError(f"row {first}")

    with pytest.raises(ValueError, match="row"):
        run_rows(work, 1000, 10, 2)
    assert len(begun) <= 2


def test_two_at_once_do_not_wait_for_each_other():
    """One call that holds the pool must not keep another from ending."""
    held, out = threading.Event(), []
    blocked = [threading.Thread(target=run_rows, args=(lambda *_: held.wait(20.0), 2, 1, 2)) for _ in range(2)]
    for each in blocked:
        each.start()
    try:
        run_rows(lambda first, last: out.append(first), 40, 10, 2)
    finally:
        held.set()
        for each in blocked:
            each.join()
    assert sorted(out) == [0, 10, 20, 30]
