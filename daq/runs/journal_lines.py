"""Lines of a journal by kind: the keys that each has, and what they may hold.

A line of a kind that is not in this table is refused when it is read, so who writes a new kind adds it here.

A frame's line takes little memory (`FrameEntry`): a million of them, hours of a flow, are 0.3 GB and not 2.  As a
dictionary a line takes 2 kB.  What most lines share, positions, size, the pulses of a chunk, is kept once;
the name of the file follows from the number; the rest stands in slots.  To those who read it is the mapping that
the line was.
"""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal, NotRequired

from pydantic import ConfigDict, Field, TypeAdapter

from daq.runs.records import Count, Crc, Positions, Record, Tag, Text, Way, Wide

Entry = Mapping[str, Any]


class SessionLine(Record):
    """A process began to work on the run."""

    kind: Literal["session"]
    utc: Text
    versions: dict[str, str]
    steps_left: Count
    controllers: NotRequired[dict[Text, str]]  # name in the bench file -> who the box says it is
    monotonic_ns: NotRequired[Wide]  # the computer's clock that stamps `received_ns`, at `utc`


Microseconds = Annotated[float, Field(gt=0.0, le=1e9)]


class PairRecord(Record):
    """Exposure and pair of light pulses of a frame, and the marker that identified it."""

    exposure: Literal["A", "B"]
    chunk: Count  # of the step: pairs that were fired in one go
    dt_us: Microseconds  # as commanded
    dt_measured_us: NotRequired[Microseconds]
    dt_sigma_us: NotRequired[Annotated[float, Field(ge=0.0, le=1e9)]]  # of the measured one
    marker: Literal["line_status", "counter", "spacing", "halves"]
    background: NotRequired[bool]  # taken before the seeding was opened


class StepRecord(Record):
    """A line about a step, and when it was written; of a chunk, when the camera was armed."""

    step: Count
    tag: Tag
    utc: Text


class FrameLine(Record):
    """A frame is on the disk under its final name."""

    kind: Literal["frame"]
    frame: Count
    file: Text
    step: Count
    tag: Tag
    crc32: Crc
    frame_id: Wide
    sequence: Wide
    timestamp_ns: Wide
    received_ns: Wide
    exposure_us: Annotated[float, Field(ge=0.0)] | None
    bits: Annotated[int, Field(ge=1, le=16)]
    sensor_px: NotRequired[Annotated[list[Count], Field(min_length=2, max_length=2)]]  # width, height
    planned_mm: Positions
    measured_mm: Positions
    true_mm: NotRequired[Positions]
    pair: NotRequired[PairRecord]  # of a flow run
    chunks: NotRequired[dict[Text, Wide | float]]  # what the camera sent with the frame, by SFNC name


class ReadingRecord(Record):
    """Reading of a gauge of the lab, or the reason why there is none."""

    utc: Text
    unit: str  # a number by itself has none
    value: NotRequired[float]
    missing: NotRequired[Text]


Gap = Annotated[list[Count], Field(min_length=2, max_length=2)]  # first and last frame that never came


class StepLine(StepRecord):
    """All frames of a step are on the disk, but for the gaps of one that may have some."""

    kind: Literal["step"]
    planned_mm: Positions
    measured_mm: Positions
    true_mm: NotRequired[Positions]
    # of axes that hands move: standard deviation of a reading in measured_mm
    reading_um: NotRequired[Positions]
    readings: NotRequired[dict[Text, ReadingRecord]]  # by the name of the device
    gaps: NotRequired[list[Gap]]


class CameraLine(Record):
    """State of the camera when a session or a step had begun or ended; see runs.clock_map."""

    kind: Literal["camera"]
    utc: Text
    # right before and behind the question
    monotonic_ns: Annotated[list[Wide], Field(min_length=2, max_length=2)]
    camera_ns: NotRequired[Wide]  # its own clock between the two, the one of `timestamp_ns`
    celsius: NotRequired[float]


class ArmLine(StepRecord):
    """A step that keeps what it has goes on with a further arm of the camera, from this frame."""

    kind: Literal["arm"]
    frame: Count
    why: Text


class ChunkLine(StepRecord):
    """Pairs that were fired in one go, and what became of them and of their frames."""

    kind: Literal["chunk"]
    chunk: Count
    fired: Count  # pairs of pulses, counted by the timing unit
    triggers: Count  # pairs of frames that the camera was triggered for
    pairs: Count  # kept
    surplus: Count  # sure, and more than were wanted
    lost: Annotated[int, Field(ge=-1_000_000_000, le=1_000_000_000)]
    dropped: dict[str, Count]  # frames, by reason
    never_came: Annotated[int, Field(ge=-1_000_000_000, le=1_000_000_000)]  # frames


class LookLine(StepRecord):
    """Offsets from the scene file that the frames of a step of an alignment show."""

    kind: Literal["look"]
    glass_mm: Way
    glass_sigma_mm: Way
    camera_mm: NotRequired[Way]  # where a board says it
    spheres: dict[Text, Way]  # those that show a rim
    remarks: list[Text]


class MissLine(StepRecord):
    """Axes stood elsewhere than a step had sent them; the step has failed."""

    kind: Literal["miss"]
    planned_mm: Positions
    measured_mm: Positions


class DiscardLine(Record):
    """Frames that do not count any more, and whose files are gone."""

    kind: Literal["discard"]
    frames: list[Count]
    why: NotRequired[str]


class AccountRecord(Record):
    """An account, see runs.frame_accounting; the sides may differ, so only the imbalance may be below 0."""

    triggered: Count
    written: Count
    incomplete: Count
    rejected: Count
    underrun: Count
    missing: Count
    ignored: Count
    silent: Count
    unwritten: Count
    lost: Count
    imbalance: Annotated[int, Field(ge=-1_000_000_000, le=1_000_000_000)]


class Percentiles(Record):
    """Of a latency."""

    p50: float
    p99: float


class FlowFigures(Record):
    """Statistics of the threads of a session, see pipeline.stats."""

    corrected_live: Count
    skipped_live: Count
    latency_ms: Percentiles | None


class CountsLine(Record):
    """Account of every triggered frame of a session."""

    kind: Literal["counts"]
    books: AccountRecord
    flow: FlowFigures
    why_rejected: NotRequired[dict[Text, Count]]
    doubt: NotRequired[Text]


class EndLine(Record):
    """A session ended by itself."""

    kind: Literal["end"]
    utc: Text
    why: Text
    error: str
    doubt: NotRequired[Text]


class AmbiguityLine(Record):
    """A frame of this session may not show what its line says; see runs.frame_accounting."""

    kind: Literal["doubt"]
    doubt: Text


Line = (
    SessionLine
    | FrameLine
    | StepLine
    | CameraLine
    | ArmLine
    | ChunkLine
    | LookLine
    | MissLine
    | DiscardLine
    | CountsLine
    | EndLine
    | AmbiguityLine
)
LINE: TypeAdapter[Any] = TypeAdapter(
    Annotated[Line, Field(discriminator="kind")], config=ConfigDict(defer_build=True)
)


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
