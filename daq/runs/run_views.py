"""What a run folder shows, for the verbs that work on finished runs: target frames, and pairs with their shift."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from daq.bench.bench_file import Vector
from daq.errors import ResumeRefused
from daq.runs.run_folder import RunFolder, frame_entries
from daq.runs.whole_text import write_text
from tracer.errors import TracerError
from tracer.scene_file import load_scene

RUN_MARK = "run.json"


@dataclass(frozen=True)
class ShiftPair:
    """Two frames of a shift experiment.

    Parameters
    ----------
    tag : str
        What the plan calls the second one.
    glass : bool
        Taken through the glass, or the clear reference.
    frames : (Path, Path)
        Before and after.
    commanded_mm, measured_mm : (float, float, float)
        Displacement of the target in the world, as planned and as the stages reported it.
    """

    tag: str
    glass: bool
    frames: tuple[Path, Path]
    commanded_mm: Vector
    measured_mm: Vector


@dataclass(frozen=True)
class View:
    """A frame of a run and what it shows: `shows` names the print, `on_plane` says that it stood at z = 0."""

    path: Path
    tag: str
    shows: str
    glass: bool
    on_plane: bool


def is_run(path: Path) -> bool:
    """Whether a folder is a run."""
    return (path / RUN_MARK).is_file()


def bench_scene(path: Path) -> str:
    """Text of the bench's scene file as it was when a run began."""
    return str(RunFolder.open(path).about["scene"])


def scene_file(path: Path, out: Path) -> Path:
    """Scene file of a run: the one its frames were corrected with as they arrived, if it still says the same.

    Otherwise the bench's scene as it was when the run began, written to ``scene.yaml`` in `out`.
    """
    about = RunFolder.open(path).about
    used = about["request"].get("scene")
    if used is not None and Path(used).is_file():
        try:
            if load_scene(used).content_hash() == about["hashes"].get("scene for the correction"):
                return Path(used)
        except TracerError:
            pass  # no longer a scene: not the file that was used
    out.mkdir(parents=True, exist_ok=True)
    write_text(out / "scene.yaml", bench_scene(path))
    return out / "scene.yaml"


def target_frames(path: Path) -> dict[str, Path]:
    """First frame of every step that photographed the target, by tag.

    Raises
    ------
    ResumeRefused
        The folder is no run, or a name in it leads outside.
    """
    folder = RunFolder.open(path)
    files = _files(folder)
    return {
        str(step["tag"]): files[step["first_frame"]]
        for step in _steps(folder)
        if step["shows"] == "chessboard" and step["first_frame"] in files
    }


def shift_pairs(path: Path) -> list[ShiftPair]:
    """Pairs of a shift experiment, in the order of the plan.

    Raises
    ------
    ResumeRefused
        The folder is no run, a name in it leads outside, or it holds no displacement.
    """
    folder = RunFolder.open(path)
    files, views = _files(folder), {str(step["tag"]): str(step["view"]) for step in _steps(folder)}
    try:
        moved = json.loads((path / "displacements.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise ResumeRefused(f"{path}: holds no displacements; evaluate a finished shift run") from None
    found = []
    for entry in moved:
        first, second = entry["frames"]
        if first in files and second in files:
            tag, glass = str(entry["tag"]), views.get(str(entry["tag"])) == "glass"
            ways = (_vector(entry["commanded_mm"]), _vector(entry["measured_mm"]))
            found.append(ShiftPair(tag, glass, (files[first], files[second]), *ways))
    if not found:
        raise ResumeRefused(f"{path}: no displacement is complete; resume the run first")
    return found


def first_view(folder: RunFolder) -> View | None:
    """First frame through the glass with the print in the plane, else what comes nearest to that."""
    files = _files(folder)
    views = [
        View(files[s["first_frame"]], str(s["tag"]), str(s["shows"]), s["view"] == "glass", bool(s["on_plane"]))
        for s in _steps(folder)
        if s["first_frame"] in files
    ]
    return max(views, key=lambda view: (view.glass, view.on_plane), default=None)


def _steps(folder: RunFolder) -> list[dict[str, Any]]:
    return list(folder.about["steps"])


def _files(folder: RunFolder) -> dict[int, Path]:
    """Frames that are on the disk, by number; every name is confined to the run."""
    return {number: folder.inside(str(entry["file"])) for number, entry in frame_entries(folder.entries()).items()}


def _vector(values: list[float]) -> Vector:
    x, y, z = values
    return (float(x), float(y), float(z))
