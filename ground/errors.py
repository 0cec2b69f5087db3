"""The root of all errors that are raised on purpose, and those of files that any package reads.

Each package has one root of its own below it, whose tree is drawn in its errors.py.  The command line prints an
error as one sentence and ends with its `exit_code`; so does `except rtpiv.ERRORS` in a script know what it caught.

RtpivError           place, cure, exit_code
+-- GroundError, TracerError, PivError, CorrectionError, StageError, DaqError

GroundError          exit code 2
+-- ConfigError      a YAML file cannot be read as what it should be (file, line, every problem at once)
+-- UntrustedProgram a file names a program of this computer that the person has not said to trust
+-- MapFileError     a stored map is damaged, of an unknown layout, or not a map at all
+-- MemoryShort      what is asked for needs more memory than is free
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

USAGE, DEVICE, INTERRUPTED = 2, 3, 4  # exit codes: usage or file; device, disk or memory; resumable


class RtpivWarning(RuntimeWarning):
    """A warning to a person, as opposed to those of libraries, which the command line does not print."""


class RtpivError(Exception):
    """Root of everything that is raised on purpose; its text is one sentence for a person.

    Parameters
    ----------
    text : str
        What is wrong; or all of the sentence, where place and cure are not separate.
    place : Path or str, optional
        File, folder or device at fault; stands in front of the sentence.
    cure : str, optional
        What to do about it; ends the sentence.

    Attributes
    ----------
    exit_code : int
        Of the command that ends with it: 2 usage or configuration, 3 device, disk or memory, 4 interrupted and
        resumable.
    """

    exit_code: ClassVar[int] = USAGE

    def __init__(self, text: object = "", *, place: Path | str | None = None, cure: str = "") -> None:
        self.place, self.cure = place, cure
        super().__init__(f"{'' if place is None else f'{place}: '}{text}{f'; {cure}' if cure else ''}")


class GroundError(RtpivError):
    """Root of everything the ground floor raises on purpose."""


@dataclass(frozen=True)
class Problem:
    """One thing wrong in a file: 1-based line (0 = the file as a whole) and what to do about it."""

    line: int
    text: str


class ConfigError(GroundError):
    """A configuration file is wrong; `problems` lists everything found, in file order."""

    def __init__(self, path: Path | str, problems: list[Problem], others: "Sequence[ConfigError]" = ()) -> None:
        self.path = Path(path)
        self.problems = sorted(problems, key=lambda problem: problem.line)
        own = [
            f"{self.path}:{problem.line}: {problem.text}" if problem.line else f"{self.path}: {problem.text}"
            for problem in self.problems
        ]
        super().__init__("\n".join([*own, *map(str, others)]))
        self.place = self.path

    @classmethod
    def merge(cls, errors: "Sequence[ConfigError]") -> "ConfigError":
        """Return one error of several files, in their order; `problems` are those of the first."""
        first, *others = errors
        same = [problem for error in others if error.path == first.path for problem in error.problems]
        rest = [error for error in others if error.path != first.path]
        return cls(first.path, [*first.problems, *same], rest)


class UntrustedProgram(GroundError):  # noqa: N818 - says what it is
    """A file names programs that would be imported and called; `names` are they."""

    def __init__(self, names: Sequence[str], file: Path) -> None:
        self.names = tuple(names)
        super().__init__(
            f"the bench file names {', '.join(names)}, a program that would be called and can do whatever you can;"
            f" if you trust who wrote the file, give --trust {','.join(names)}, or add the name to {file}"
        )


class MapFileError(GroundError):
    """A map file cannot be read; trace the scene again."""


class MemoryShort(GroundError):  # noqa: N818 - says what it is
    """Too little memory; the message says how much is needed and how much is free."""

    exit_code = DEVICE
