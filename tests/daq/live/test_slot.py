"""The place in memory through which a run is looked at."""

import threading
import time
from pathlib import Path

import numpy as np
import pytest

from daq.pipeline.live_slot import NoSlotError, SlotReader, SlotWriter


def test_a_moment_is_whole_however_fast_the_writer_is() -> None:
    """Every pixel of a snapshot has the number of the snapshot, while it is overwritten as fast as it can be."""
    writer = SlotWriter(4 * 300 * 400)
    reader = SlotReader(writer.path)
    assert reader.latest() is None
    ends = threading.Event()

    def write() -> None:
        number = 0
        while not ends.is_set():
            number += 1
            writer.put({"number": number}, {"raw": np.full((300, 400), number % 60_000, np.uint16)})

    thread = threading.Thread(target=write)
    thread.start()
    seen: list[int] = []
    end_s = time.monotonic() + 20.0
    while len(set(seen)) < 50 and time.monotonic() < end_s:
        snapshot = reader.latest()
        if snapshot is not None:
            assert snapshot.words["number"] == snapshot.number
            assert (snapshot.pictures["raw"] == snapshot.number % 60_000).all()
            seen.append(snapshot.number)
    ends.set()
    thread.join()
    assert seen == sorted(seen)
    assert len(set(seen)) == 50
    writer.close()
    assert reader.is_over


def test_two_pictures_come_back_as_they_were() -> None:
    writer = SlotWriter(10_000)
    corrected = np.array([[1.5, np.nan]], np.float32)
    writer.put({"text": "ä"}, {"raw": np.arange(6, dtype=np.uint16).reshape(2, 3), "corrected": corrected})
    snapshot = SlotReader(writer.path).latest()
    assert snapshot is not None
    assert snapshot.words == {"text": "ä"}
    np.testing.assert_array_equal(snapshot.pictures["raw"], [[0, 1, 2], [3, 4, 5]])
    np.testing.assert_array_equal(snapshot.pictures["corrected"], corrected)
    writer.put({}, {"raw": np.zeros((200, 200), np.uint16)})  # does not fit
    late = SlotReader(writer.path).latest()
    assert late is not None
    assert late.pictures == {}
    writer.put({"text": "x" * 100_000}, {})
    wordless = SlotReader(writer.path).latest()
    assert wordless is not None
    assert wordless.words == {}
    writer.close()


def test_what_is_no_slot_is_refused(tmp_path: Path) -> None:
    with pytest.raises(NoSlotError):
        SlotReader(tmp_path / "none")
    for content in (b"", b"x" * 10, b"rtpivlv1" + b"\xff" * 5000):
        (tmp_path / "slot").write_bytes(content)
        with pytest.raises(NoSlotError):
            SlotReader(tmp_path / "slot")
