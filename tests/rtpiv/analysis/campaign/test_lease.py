"""Leases: silence is measured by looking twice, never by anybody's clock."""

import json
import os

import pytest

from rtpiv.analysis.campaign.chunk_task import Lease, LeaseInfo, read_lease, take

HOUR_NS = 3600 * 10**9


@pytest.fixture
def path(tmp_path):
    return tmp_path / "leases" / "one-00000.json"


def of_another(path, token="a" * 32, host="elsewhere", pid=1):
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps({"token": token, "host": host, "pid": pid}))


def test_one_takes_it_and_the_next_is_told_who(path):
    lease = take(path)
    assert isinstance(lease, Lease)
    held = take(path)
    assert isinstance(held, LeaseInfo)
    assert (held.pid, held.is_gone) == (os.getpid(), False)
    lease.give_back()
    assert read_lease(path) is None
    assert isinstance(take(path), Lease)


def test_a_beat_is_seen_whatever_the_clocks_say(path):
    of_another(path)
    for off_ns in (-HOUR_NS, HOUR_NS):  # the disk's clock is an hour off
        os.utime(path, ns=(10**18, 10**18 + off_ns))
        before = take(path)
        assert isinstance(before, LeaseInfo)
        Lease(path, "a" * 32).beat()
        assert take(path).beat_ns != before.beat_ns


@pytest.mark.posix("whether a process is there")
def test_a_process_that_is_gone_is_known_to_be_gone_on_its_own_computer_alone(path):
    lease = take(path)
    said = json.loads(path.read_text())
    of_another(path, host=said["host"], pid=2**22 + 1)
    assert isinstance(take(path), Lease)
    of_another(path, pid=2**22 + 1)
    assert isinstance(take(path), LeaseInfo)
    lease.give_back()
    assert read_lease(path) is not None  # it is no longer ours


def test_a_void_lease_is_taken_over_by_its_token_alone(path):
    of_another(path)
    assert isinstance(take(path, over="b" * 32), LeaseInfo)
    assert isinstance(take(path, over="a" * 32), Lease)
    assert read_lease(path).pid == os.getpid()


@pytest.mark.parametrize("content", ["", "{", '{"token": "a", "host": "b", "pid": 1}', "x" * 20000])
def test_a_file_that_says_nothing_is_held_by_nobody_known(path, content):
    """Its writer died while it wrote: void as soon as it has been silent."""
    path.parent.mkdir()
    path.write_text(content)
    held = take(path)
    assert isinstance(held, LeaseInfo)
    assert (held.token, held.is_gone) == ("", False)
    assert isinstance(take(path, over=""), Lease)


def test_a_beat_on_a_lease_that_is_gone_is_no_error(path):
    lease = take(path)
    path.unlink()
    lease.beat()
    lease.give_back()
