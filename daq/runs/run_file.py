"""run.json: what a run was asked for, on the disk before its first frame and never changed.

Layout 2 seals this file and every other record of the run (runs.seal); runs of layout 1, made before there
were seals, are read as they are.
"""

import json
from pathlib import Path
from typing import Annotated, Any, Literal, NotRequired

from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter, with_config
from typing_extensions import TypedDict  # that of typing cannot be checked before Python 3.12

from daq.errors import RunDamaged, RunUnsuitable
from daq.runs.names import FILE
from daq.runs.records import CURE, MAX_RECORD_BYTES, Count, Record, Tag, Text, read_record
from daq.runs.seal import SealBroken, check_seal
from ground.plain_file import read_plain

LAYOUT = 2
LAYOUTS = (1, 2)
SEALED_FROM = 2


CameraName = Annotated[str, Field(pattern="^[A-Za-z][A-Za-z0-9_]{0,63}$")]  # it becomes a folder


@with_config(ConfigDict(extra="forbid", strict=True))
class AskedFor(TypedDict):
    """The request, see runner.session; the files of bench and plan are read again from here."""

    bench: Text
    plan: Text
    simulate: bool
    correct: bool
    scene: NotRequired[Text | None]
    target_clear: NotRequired[Text | None]
    dewarp_order: Annotated[int, Field(ge=2, le=5)]
    method: Literal["quintic", "bilinear"]
    live_queue: Annotated[int, Field(ge=1, le=1_000_000)]
    rehearsed: NotRequired[bool]
    seed: NotRequired[Annotated[int, Field(ge=0, le=2**31)] | None]


class PlannedStep(Record):
    """A step of the plan, as far as those who work on finished runs need it."""

    index: Count
    tag: Tag
    first_frame: Count
    frames: Annotated[int, Field(ge=1, le=1_000_000_000)]
    view: Literal["clear", "glass"]
    shows: Text
    on_plane: bool
    reference: Count | None
    group: NotRequired[Annotated[int, Field(ge=1, le=1000)]]  # frames that belong together; 1 if not said
    dt_us: NotRequired[Annotated[float, Field(gt=0.0, le=1e9)]]  # between the two light pulses of a pair
    background: NotRequired[bool]  # pairs without seeding


def _in_order(steps: list[PlannedStep]) -> list[PlannedStep]:
    first = 0
    for place, step in enumerate(steps):
        if step["index"] != place or step["first_frame"] != first:
            raise ValueError(f"step {place} is not the next one, or does not begin with frame {first}")
        if step["reference"] is not None and step["reference"] >= len(steps):
            raise ValueError(f"step {place} is displaced from step {step['reference']}, which does not exist")
        first += step["frames"]
    return steps


class RunFile(Record):
    """A whole run.json."""

    layout: Literal[1, 2]
    name: Text
    request: AskedFor
    hashes: dict[str, str | None]
    versions: dict[str, str]
    plan: str
    bench: str
    scene: str
    square_mm: Annotated[float, Field(gt=0.0, le=1e6)]
    disc_mm: NotRequired[Annotated[float, Field(gt=0.0, le=1e6)]]  # older runs do not say it
    board: NotRequired[Text]  # board.yaml, if the bench names one
    steps: Annotated[list[PlannedStep], AfterValidator(_in_order)]
    cameras: NotRequired[
        Annotated[list[CameraName], Field(min_length=1, max_length=8)]
    ]  # further ones: cameras/NAME


RUN_FILE: TypeAdapter[RunFile] = TypeAdapter(RunFile)


def read_run_file(folder: Path) -> RunFile:
    """Read and check the run.json of a folder.

    Raises
    ------
    RunUnsuitable
        There is none, or it is of an unknown layout.
    RunDamaged
        It is not what was written.
    """
    path = folder / FILE
    if not path.exists():
        raise RunUnsuitable(f"{folder}: is not a run folder (it has no {FILE})")
    return read_record(RUN_FILE, path, sealed=_layout(path) >= SEALED_FROM)


def _layout(path: Path) -> int:
    """Layout of a run, before anything else is believed; one that is not known makes the rest unreadable.

    A seal that is broken is found in a tenth of a second, in whatever takes a minute to be taken apart.
    """
    try:
        tree: Any = json.loads(check_seal(read_plain(path, MAX_RECORD_BYTES), required=False))
    except SealBroken as error:
        raise RunDamaged(f"{path}: {error}, so it is not what was written; {CURE}") from None
    except (OSError, ValueError, RecursionError):
        return LAYOUT  # what is wrong with it is said by the one who reads it in full
    layout = tree.get("layout") if isinstance(tree, dict) else None
    if isinstance(layout, int) and layout not in LAYOUTS:
        raise RunUnsuitable(f"{path}: has layout {layout}, known are {LAYOUTS}; read it with a newer version")
    if layout not in LAYOUTS:
        raise RunDamaged(f"{path}: lacks the layout version of the run; {CURE}")
    return int(layout)
