"""Frames of a run that do not show what its journal says, by the truth printed into them (`sim.frame_truth`)."""

from dataclasses import dataclass
from pathlib import Path

from daq.runs.raw_frame import read_raw
from daq.runs.run_folder import RunFolder, frame_entries
from sim.frame_truth import truth_of

FILED_WITHIN_MM = 0.15  # measured positions may be off by play, lead error and the edge of the reference


@dataclass(frozen=True)
class Misfiled:
    """A frame that does not show what its line in the journal says."""

    frame: int
    why: str


def find_misfiled(run: Path | str, within_mm: float = FILED_WITHIN_MM) -> list[Misfiled]:
    """Compare every frame of a run's journal with what it really shows; return those that are filed wrongly.

    A frame is if an axis truly stood more than `within_mm` from where the line says it was measured, if anything
    moved while it was exposed, or if the same exposure is filed more than once.

    Raises
    ------
    NoTruth
        A frame carries none; the run was not made on a bench with ``prints_truth``.
    RunDamaged
        The journal or a frame is not what was written.
    """
    folder = RunFolder(Path(run))
    found: list[Misfiled] = []
    first_with: dict[tuple[int, int], int] = {}
    for number, entry in sorted(frame_entries(folder.entries()).items()):
        measured_mm: dict[str, float] = entry["measured_mm"]
        pixels, _ = read_raw(folder.path / entry["file"], entry["crc32"])
        truth = truth_of(pixels, list(measured_mm))
        for axis, at_mm in measured_mm.items():
            off_mm = truth.true_mm[axis] - at_mm
            if abs(off_mm) > within_mm:
                text = f"{axis} is said to be at {at_mm:.3f} mm and truly was at {truth.true_mm[axis]:.3f} mm"
                found.append(Misfiled(number, text))
        if truth.is_moving:
            found.append(Misfiled(number, "something moved while it was exposed"))
        exposure = (truth.world, truth.exposure)
        if exposure in first_with:
            found.append(Misfiled(number, f"it is the same exposure as frame {first_with[exposure]}"))
        first_with.setdefault(exposure, number)
    return found
