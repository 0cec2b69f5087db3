"""Errors of the tracer; the command line prints them as one sentence and exits with code 2.

    TracerError
    +-- SceneError       the scene is well-formed but impossible: overlap, camera inside glass, n < 1
    +-- StaleMap         a stored map belongs to another scene
    +-- RayMapUsageError a ray map is asked for that cannot be (also a ValueError)

Files that cannot be read raise errors of `ground`.  Rays never raise: each carries a RayStatus.
"""

from ground.errors import RtpivError


class TracerError(RtpivError):
    """Root of everything the tracer raises on purpose."""


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


class StaleMap(TracerError):  # noqa: N818 - says what it is
    """A map was made from another scene; trace the scene again."""


class RayMapUsageError(TracerError, ValueError):
    """A ray map is asked for that cannot be."""
