"""A frame's line of a journal in little memory: a million of them, hours of a flow, are 0.3 GB and not 2.

As a dictionary a line takes 2 kB.  What most lines share, positions, size, the pulses of a chunk, is kept once;
the name of the file follows from the number; the rest stands in slots.  To those who read it is the mapping that
the line was.
"""

from collections.abc import Iterator, Mapping
from typing import Any

_PLAIN = (
    "frame", "step", "tag", "frame_id", "sequence", "timestamp_ns", "received_ns", "exposure_us", "bits",
    "sensor_px", "planned_mm", "measured_mm", "true_mm", "pair",
)  # fmt: skip
OFTEN = ("planned_mm", "measured_mm", "true_mm", "sensor_px", "pair")  # not in every line
_IS_PLAIN = frozenset(_PLAIN)  # asked a million times
_KEYS = ("kind", "file", "crc32", *_PLAIN)
ALWAYS = len(_KEYS) - len(OFTEN)
MOST_SHARED = 10_000  # different values that are remembered


class FrameEntry(Mapping[str, Any]):
    """One line of the kind `frame`.

    Parameters
    ----------
    line : mapping
        The checked line.
    shared : dict
        Values of earlier lines of this journal; what is equal is kept once.
    """

    __slots__ = ("_crc32", "_file", "_more", *_PLAIN)

    def __init__(self, line: Mapping[str, Any], shared: dict[object, object]) -> None:
        if len(shared) > MOST_SHARED:
            shared.clear()
        once = shared.setdefault
        self.frame = frame = line["frame"]
        self.step, self.bits = line["step"], line["bits"]
        self.timestamp_ns, self.received_ns = line["timestamp_ns"], line["received_ns"]
        self.sequence = frame if line["sequence"] == frame else line["sequence"]
        self.frame_id = frame if line["frame_id"] == frame else line["frame_id"]
        self.tag = once(line["tag"], line["tag"])
        self.exposure_us = once(line["exposure_us"], line["exposure_us"])
        known = ALWAYS
        for key in OFTEN:
            if key in line:
                value = line[key]
                known += 1
                setattr(self, key, once(tuple(value.items() if isinstance(value, dict) else value), value))
        self._crc32 = int(line["crc32"], 16)
        self._file = None if line["file"] == frame_name(frame) else line["file"]
        self._more = None
        if len(line) > known:
            self._more = {key: value for key, value in line.items() if key not in _KEYS}

    def __getitem__(self, key: str) -> Any:  # noqa: ANN401
        if key in _IS_PLAIN:
            try:
                return getattr(self, key)
            except AttributeError:
                raise KeyError(key) from None
        if key == "kind":
            return "frame"
        if key == "file":
            return self._file or frame_name(self.frame)
        if key == "crc32":
            return f"{self._crc32:08x}"
        if self._more is None:
            raise KeyError(key)
        return self._more[key]

    def __iter__(self) -> Iterator[str]:
        yield from ("kind", "file", "crc32")
        yield from (key for key in _PLAIN if hasattr(self, key))
        yield from self._more or ()

    def __len__(self) -> int:
        return sum(1 for _ in self)


def frame_name(number: int) -> str:
    """Name of a raw frame within its run."""
    return f"frames/{number:06d}.tif"
