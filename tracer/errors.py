"""Errors of the tracer; the command line prints them as one sentence and exits with code 2.

    TracerError
    +-- ConfigError      a YAML file cannot be read as what it should be (file, line, every problem at once)
    +-- SceneError       the scene is well-formed but impossible: overlap, camera inside glass, n < 1
    +-- MapFileError     a stored map is damaged, of an unknown layout, or not a map at all
    +-- StaleMap         a stored map belongs to another scene

Rays never raise: each carries a RayStatus.
"""

from dataclasses import dataclass
from pathlib import Path


class TracerError(Exception):
    """Root of everything the tracer raises on purpose."""


@dataclass(frozen=True)
class Problem:
    """One thing wrong in a file: 1-based line (0 = the file as a whole) and what to do about it."""

    line: int
    text: str


class ConfigError(TracerError):
    """A configuration file is wrong; `problems` lists everything found, in file order."""

    def __init__(self, path: Path | str, problems: list[Problem]) -> None:
        self.path = Path(path)
        self.problems = sorted(problems, key=lambda problem: problem.line)
        super().__init__(
            "\n".join(
                f"{self.path}:{problem.line}: {problem.text}" if problem.line else f"{self.path}: {problem.text}"
                for problem in self.problems
            )
        )


class SceneError(TracerError):
    """The scene cannot exist as described; the message names the bodies and the cure.

    Parameters
    ----------
    text : str
        What is wrong, or the first problem.
    problems : list of (str, str), optional
        Every problem as (name of the body at fault or "", sentence).
    """

    def __init__(self, text: str = "", problems: list[tuple[str, str]] | None = None) -> None:
        self.problems = problems or [("", text)]
        super().__init__("; ".join(sentence for _, sentence in self.problems))


class MapFileError(TracerError):
    """A map file cannot be read; trace the scene again."""


class StaleMap(TracerError):  # noqa: N818 - says what it is
    """A map was made from another scene; trace the scene again."""
