"""What is left out of the live thread: the oldest, and whole groups only."""

import random
import threading

from daq.pipeline.live_queue import LiveQueue
from tests.loops import loop_over


def put(queue, number, size=2, room=True):
    return queue.put(number, (0, number - number % size), size, room)


def test_frames_of_their_own_go_one_by_one():
    queue = LiveQueue(2)
    assert [put(queue, number, size=1) for number in range(4)] == [[], [], [0], [1]]
    assert [queue.take(), queue.take()] == [2, 3]


def test_a_pair_waits_even_where_one_frame_is_the_limit():
    queue = LiveQueue(1)
    assert put(queue, 0) == []
    assert put(queue, 1) == []
    assert put(queue, 2) == [0, 1]
    assert put(queue, 3) == []
    assert [queue.take(), queue.take()] == [2, 3]


def test_a_pair_that_was_begun_is_brought_to_its_end():
    queue = LiveQueue(1)
    put(queue, 0)
    assert queue.take() == 0
    assert [put(queue, number) for number in (2, 1, 3, 4)] == [[], [], [], [2, 3]]
    assert queue.take() == 1
    assert queue.take() == 4


def test_a_frame_follows_the_one_that_was_left_out():
    queue = LiveQueue(1)
    put(queue, 0)
    put(queue, 2)
    assert put(queue, 3) == [0]
    assert put(queue, 1) == [1]
    assert [queue.take(), queue.take(), len(queue)] == [2, 3, 0]


def test_without_room_no_pair_begins_and_none_is_torn():
    queue = LiveQueue(4)
    assert put(queue, 0, room=False) == [0]
    assert put(queue, 1, room=True) == [1]
    assert put(queue, 2, room=True) == []
    assert put(queue, 3, room=False) == []
    assert queue.take() == 2
    assert queue.take() == 3


def test_a_frame_that_is_being_worked_on_gets_its_partner_without_room():
    queue = LiveQueue(4)
    put(queue, 0)
    assert queue.take() == 0
    assert put(queue, 1, room=False) == []
    assert queue.take() == 1


def test_who_waits_hears_the_end():
    queue, heard = LiveQueue(1), []
    thread = threading.Thread(target=lambda: heard.append(queue.take()))
    thread.start()
    queue.end()
    thread.join(10.0)
    assert heard == [None]


@loop_over("size", [1, 2, 3])
@loop_over("seed", range(20))
def test_whatever_the_speed_nothing_is_torn_lost_or_kept_twice(size, seed):
    """A thread that takes at random: every group is done as a whole or left out as a whole."""
    chance, limit = random.Random(seed), 1 + seed % 5
    queue, done, dropped = LiveQueue(limit), [], []
    for number in range(60 * size):
        dropped += put(queue, number, size, room=chance.random() > 0.1)
        assert len(queue) <= max(limit, size) + size - 1
        while len(queue) and chance.random() < 0.4:
            done.append(queue.take())
    queue.end()
    while (item := queue.take()) is not None:
        done.append(item)
    assert sorted(done + dropped) == list(range(60 * size))
    assert done == sorted(done)
    assert {number // size for number in done}.isdisjoint(number // size for number in dropped)
