"""State of a fit between its stages."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from correction.errors import ViewsMissing
from correction.fit.adjustment import Adjustment
from correction.fit.judge.result import FitStep
from correction.fit.seen.measurement import (
    MeasuredFrame,
    TargetFrame,
)
from correction.fit.seen.silhouettes import Outlines
from correction.fit.seen.smear import Dispersion
from correction.fit.solve.unknowns import Unknowns, pose_label, unknowns_of
from correction.target import Chessboard
from correction.target.board_search import SATURATED
from correction.target.corners import fraction_saturated
from correction.target.lattice_growth import Saddles, lattice_saddles
from correction.target.marks import find_marks
from tracer.camera import Vector3
from tracer.scene.fit_section import FitTable
from tracer.scene.scene import Scene
from tracer.strategies.sensitivity import TARGET

NO_SHADOW = 1e-9  # share by which a lower level in plain light is wider than the face
RIM_REACH = 0.8  # squares: rims are seen to a few tenths of one


class Progress:
    """State of a fit between its stages: free numbers, measured corners, steps so far."""

    def __init__(
        self,
        nominal: Scene,
        frames: Sequence[TargetFrame],
        board: Chessboard,
        priors: FitTable,
        say: Callable[[str], None],
    ) -> None:
        self.bare_frames = sorted((f for f in frames if not f.glass), key=_far)
        self.glass_frames = sorted((f for f in frames if f.glass), key=_far)
        if not self.bare_frames or _far(self.bare_frames[0]) != (False, 0.0):
            raise ViewsMissing("a frame of the bare target at z = 0 is needed: it defines the world; take one")
        if nominal.spheres and not self.glass_frames:
            raise ViewsMissing("the scene has spheres but no frame shows the target through them; take one")
        self.board, self.say, self.history = board, say, list[FitStep]()
        self.nominal, self.priors, self.heights = nominal, priors, [f.height_mm for f in frames if not f.pose]
        self.poses = {pose: np.zeros(len(TARGET)) for pose in sorted({f.pose for f in frames if f.pose})}
        self.focal_free = len({(f.pose, f.height_mm) for f in self.bare_frames}) >= 3
        self.shadow_mm = 0.0  # by which shadows may shift all dots of the lower level of a plate
        self.shadow_share = NO_SHADOW  # and draw them apart
        self.unknowns = self.unknowns_of(nominal, priors)
        self.full = self.unknowns.start
        self.bare: list[MeasuredFrame] = []
        self.behind: list[MeasuredFrame] = []
        self.fits = Adjustment()
        self.dispersion: Dispersion | None = None
        self.outlines: Outlines | None = None
        self.explained = 0.0
        self.unplaced = ""
        self.others: list[NDArray[np.float64]] = []
        self.found_saddles: dict[str, Saddles] = {}
        for warning in map(_saturation_warning, frames):
            if warning:
                self.note(FitStep(warning))

    def unknowns_of(
        self,
        nominal: Scene,
        priors: FitTable,
        travel: Vector3 = (0.0, 0.0, 1.0),
        board: Chessboard | None = None,
    ) -> Unknowns:
        """Number what is free around a nominal scene, with a target that the stage moves along `travel`."""
        board = board or self.board
        aside_mm = max(board.step_sigma_mm, self.shadow_mm)
        known = (*board.print_sigma, *(aside_mm, aside_mm, self.shadow_share) * (len(board.depths_mm) - 1))
        bench = unknowns_of(nominal, self.heights, priors, self.focal_free, travel, known, self.poses)
        return replace(bench, origin_is_deep=board.depths_mm[-1] < 0.0)

    def note(self, step: FitStep) -> None:
        """Remember a step and say it."""
        self.history.append(step)
        self.say(str(step))

    @property
    def walls(self) -> list[str]:
        """Beginnings of the names of numbers of windows and tubes, through which the bare target is seen."""
        return [f"{body.name}." for body in self.nominal.bodies if body.stays]

    def height_number(self, frame: TargetFrame) -> int:
        """Number of a frame's height, or of its pose by hand."""
        if frame.pose:
            return len(self.unknowns.heights_mm) + self.unknowns.poses.index(frame.pose)
        return int(np.argmin(np.abs(np.array(self.unknowns.heights_mm) - frame.height_mm)))

    def put_pose(self, pose: str, values: NDArray[np.float64]) -> None:
        """Start a pose by hand from where it was found: x, y, z [mm] and turn (6,)."""
        place = self.unknowns.place(len(self.unknowns.heights_mm) + self.unknowns.poses.index(pose))
        start, self.full = self.unknowns.start.copy(), self.full.copy()
        start[place] = self.full[place] = self.poses[pose] = values
        self.unknowns = self.unknowns.around(start)

    def drop_pose(self, pose: str, why: str) -> None:
        """Leave out the frames of a pose by hand, and say why."""
        self.unknowns = self.unknowns.without(pose_label(pose))
        names = [frame.name for frame in (*self.bare_frames, *self.glass_frames) if frame.pose == pose]
        self.bare = [frame for frame in self.bare if frame.name not in names]
        self.bare_frames = [frame for frame in self.bare_frames if frame.pose != pose]
        self.glass_frames = [frame for frame in self.glass_frames if frame.pose != pose]
        self.note(FitStep(f"warning: {' and '.join(names)} left out: {why}"))

    def saddles(self, frame: TargetFrame) -> Saddles:
        """Saddles of a frame, or dots, looked for once."""
        if frame.name not in self.found_saddles:
            self.found_saddles[frame.name] = find_marks(frame.image, self.board)
        return self.found_saddles[frame.name]

    def corner_saddles(self, frame: TargetFrame) -> Saddles:
        """Those of them that may be corners of the board: the cells of markers have saddles as well."""
        if self.board.codes is None:
            return self.saddles(frame)
        return lattice_saddles(frame.image, self.saddles(frame), self.board.square_mm / self.pitch_mm)

    @property
    def pitch_mm(self) -> float:
        """A corrected pixel on the plane."""
        camera = self.unknowns.camera(self.full)
        return camera.position_mm[2] / camera.focal_px

    @property
    def print_found(self) -> Chessboard:
        """The board as large as its print was found to be; the solver deepens the step of a plate."""
        return self.board.stretch(self.unknowns.stretch(self.full)[:2])

    def rims_elsewhere(self, scene: Scene) -> dict[str, Vector3]:
        """Balls of a scene that do not stand where their own rims are seen, with their centres there."""
        if self.outlines is None:
            return {}
        beside = self.outlines.beside(scene, RIM_REACH * self.board.square_mm).tolist()
        places = zip(self.outlines.names, self.outlines.place_mm.tolist(), beside, strict=True)
        return {name: (x, y, z) for name, (x, y, z), is_beside in places if is_beside}


def _far(frame: TargetFrame) -> tuple[bool, float]:
    """Order of frames: by distance from the plane, those of a pose by hand last."""
    return bool(frame.pose), abs(frame.height_mm)


def _saturation_warning(frame: TargetFrame) -> str:
    """Return a warning about a frame with saturated paper: its edges move, those of a corner all alike."""
    share = fraction_saturated(frame.image)
    if share <= SATURATED:
        return ""
    return (
        f"warning: {frame.name}: {100.0 * share:.0f} % of the pixels are saturated, which widens bright squares;"
        " corners are used where their edges are sharp, but expose shorter for the best accuracy"
    )
