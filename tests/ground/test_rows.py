"""Rows and parts on all cores: each once, errors out, nothing begun after an error."""

import threading
import time
from collections.abc import Iterator

import pytest

from ground.rows import LEAST_ROWS, map_parts, run_parts, run_rows
from tests.loops import loop_over


@loop_over("rows", [0, 1, 7, 16, 17, 100, 2016])
@loop_over("block", [None, 1, 24])
@loop_over("threads", [1, 2, 5])
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


@pytest.mark.parametrize("threads", ["1", "3"])
def test_parts_are_worked_on_while_later_ones_are_made_and_few_are_held(
    threads: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RTPIV_THREADS", threads)
    lock, waiting, most, done = threading.Lock(), 0, 0, []

    def parts() -> Iterator[int]:
        nonlocal waiting, most
        for part in range(50):
            with lock:
                waiting += 1
                most = max(most, waiting)
            yield part

    def work(part: int) -> None:
        nonlocal waiting
        with lock:
            waiting -= 1
            done.append(part)

    run_parts(work, parts())
    assert sorted(done) == list(range(50))
    assert most <= 2 * int(threads) + 3


@pytest.mark.parametrize("threads", ["1", "2"])
def test_a_part_that_fails_is_not_silent(threads: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RTPIV_THREADS", threads)
    with pytest.raises(ZeroDivisionError):
        run_parts(lambda part: 1 // part, iter((3, 0, 2)))


@pytest.mark.parametrize("threads", ["1", "3"])
def test_what_parts_give_comes_in_their_order(threads: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever is done first; and so do errors."""
    monkeypatch.setenv("RTPIV_THREADS", threads)

    def square(number: int) -> int:
        time.sleep(0.01 * max(5 - number, 0))
        if number > 5:
            raise ValueError(number)
        return number * number

    assert map_parts(square, range(6)) == [0, 1, 4, 9, 16, 25]
    with pytest.raises(ValueError, match="6"):
        map_parts(square, [*range(3), 6, 7])
    assert map_parts(square, []) == []
