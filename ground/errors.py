"""Errors of files that any package reads; the command line prints them as one sentence and exits with code 2.

GroundError
+-- ConfigError      a YAML file cannot be read as what it should be (file, line, every problem at once)
+-- UntrustedProgram a file names a program of this computer that the person has not said to trust
+-- MapFileError     a stored map is damaged, of an unknown layout, or not a map at all
+-- MemoryShort      what is asked for needs more memory than is free
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path


class GroundError(Exception):
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

    @classmethod
    def joined(cls, errors: "Sequence[ConfigError]") -> "ConfigError":
        """Return one error of several files, told in their order; `problems` are those of the first."""
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
    """What is asked for does not fit into memory; the message says how much it needs and how much is free."""
