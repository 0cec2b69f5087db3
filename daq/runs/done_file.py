"""done.json: the last thing a run writes, and the only sign that it is finished."""

from typing import Annotated, NotRequired

from pydantic import Field, TypeAdapter, with_config
from typing_extensions import TypedDict  # that of typing cannot be checked before Python 3.12

from daq.runs.journal_lines import Books, FlowFigures, Gap
from daq.runs.records import STRICT, Count, Sha, Tag, Text, read_record
from daq.runs.run_file import SEALED_FROM
from daq.runs.run_folder import RunFolder

FILE = "done.json"
Signed = Annotated[int, Field(ge=-1_000_000_000, le=1_000_000_000)]


@with_config(STRICT)
class SessionEnd(TypedDict):
    """How a session ended, and its books: below 0 where it discarded what an earlier one had written."""

    utc: Text
    ended: Text
    error: str
    conservation: dict[Text, Signed]


@with_config(STRICT)
class StepGaps(TypedDict):
    """Frames that a step never got."""

    step: Count
    tag: Tag
    gaps: list[Gap]


@with_config(STRICT)
class DoneFile(TypedDict):
    """A whole done.json."""

    utc: Text
    steps: Count
    frames: Count
    conservation: Books
    sessions: list[SessionEnd]
    corrected_after_the_run: Count
    gaps: NotRequired[list[StepGaps]]
    flow: list[FlowFigures]
    sha256: NotRequired[Sha]  # of the whole run, see runs.run_hash; since layout 2


DONE_FILE: TypeAdapter[DoneFile] = TypeAdapter(DoneFile)


def read_done(folder: RunFolder) -> DoneFile | None:
    """Read done.json; None while the run is not finished.

    Raises
    ------
    RunDamaged
        It is not what was written.
    """
    if not folder.is_done:
        return None
    return read_record(DONE_FILE, folder.path / FILE, folder.about["layout"] >= SEALED_FROM)
