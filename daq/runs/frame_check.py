"""Whether the frames of a run are still what its journal acknowledged."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Protocol, TypeVar

from daq.errors import RunDamaged
from daq.runs.journal import Entry
from daq.runs.raw_frame import read_raw
from daq.runs.run_folder import RunFolder

T = TypeVar("T")
NAMED = 5  # frames that a sentence names


class Track(Protocol):
    """Passes items on and shows how many of `total` are done; see ground.terminal.progress."""

    def __call__(self, items: Iterable[T], total: int, what: str) -> Iterator[T]:
        """Yield `items`."""
        ...


def untracked(items: Iterable[T], total: int, what: str) -> Iterator[T]:
    """Yield `items` and show nothing."""
    yield from items


@dataclass(frozen=True, slots=True)
class FrameFault:
    """A frame that is not what was written.

    Parameters
    ----------
    number, step : int
        The frame, and the step that it belongs to.
    file : str
        Its name within the run.
    what : str
        What is wrong with it, as the rest of a sentence.
    """

    number: int
    step: int
    file: str
    what: str


def frame_faults(
    folder: RunFolder, acknowledged: Mapping[int, Entry], track: Track = untracked
) -> list[FrameFault]:
    """Read frames and compare them with their lines in the journal: pixels, and what the file says about them.

    Parameters
    ----------
    folder : RunFolder
        The run.
    acknowledged : mapping of int to dict
        Lines of the frames in question, by number; see `frame_entries`.
    track : Track, optional
        Shows how far it is.
    """
    found = []
    for number, entry in track(sorted(acknowledged.items()), len(acknowledged), f"checking {folder.path.name}"):
        if what := _fault(folder, entry):
            found.append(FrameFault(number, entry["step"], entry["file"], what))
    return found


def named(faults: list[FrameFault]) -> str:
    """Name the first few of some faults, and say how many more there are."""
    more = f" and {len(faults) - NAMED} more" if len(faults) > NAMED else ""
    return ", ".join(f"{fault.file} {fault.what}" for fault in faults[:NAMED]) + more


def _fault(folder: RunFolder, entry: Entry) -> str:
    path = folder.inside(entry["file"])
    if not path.is_file():
        return "is missing"
    try:
        _, about = read_raw(path, entry["crc32"])
    except RunDamaged as error:
        return str(error).removeprefix(f"{path}: ").partition(";")[0]
    differing = [key for key, value in about.items() if key not in entry or entry[key] != value]
    return f"says something else about its {differing[0]} than the journal" if differing else ""
