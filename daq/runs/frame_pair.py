"""Two frames between which something has moved."""

from dataclasses import dataclass
from pathlib import Path

from daq.bench.bench_table import Vector


@dataclass(frozen=True)
class FramePair:
    """Two frames between which something has moved.

    Parameters
    ----------
    tag : str
        Names the pair within its run.
    glass : bool
        Taken through the glass, or bare.
    frames : (Path, Path)
        Before and after, always two files: a buffer with both exposures is cut in two as it arrives.
    commanded_mm, measured_mm : (float, float, float), optional
        Displacement of the target in the world, as planned and as the stages reported it; None if it did not move.
    dt_s : float, optional
        From the first exposure, or light pulse, to the second: measured if somebody did, else commanded; None if
        nobody knows.
    dt_sigma_s : float, optional
        Standard deviation of `dt_s`; None if nobody measured it.
    time_s : float, optional
        From the first exposure of the first pair of the run to that of this one, on the camera's clock; across a
        restart of the camera or of the run, on the computer's. None if the camera has no clock.
    is_background : bool
        Taken before the seeding was opened: reflections and dark level, no particles.
    """

    tag: str
    glass: bool
    frames: tuple[Path, Path]
    commanded_mm: Vector | None = None
    measured_mm: Vector | None = None
    dt_s: float | None = None
    dt_sigma_s: float | None = None
    time_s: float | None = None
    is_background: bool = False
