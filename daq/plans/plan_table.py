"""Keys of every experiment's plan file, and the interface of an experiment."""

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from daq.bench.bench_table import Bench
from daq.bench.elements import Vector
from daq.plans.pulse_order import PulseOrder
from daq.plans.steps import CLEAR, Step
from ground.config import Table
from ground.usual import Usual

View = Literal["clear", "glass"]
NoteKey = Annotated[str, Field(min_length=1, max_length=60)]
Note = bool | int | float | Annotated[str, Field(max_length=1000)]

Question = tuple[tuple[str | int, ...], str]  # place in a plan file, and what is asked about it


@dataclass(frozen=True, slots=True)
class Pose:
    """One thing to photograph, in the words of an experiment.

    Parameters
    ----------
    tag : str
        Name of what is seen.
    target_mm : (float, float, float)
        Displacement of the target from its place in the scene.
    view : str
        ``clear`` or ``glass``.
    reference : int or None
        Number, within the poses, of the pose that this one is displaced from.
    camera_mm : (float, float, float)
        Displacement of the camera from its place in the scene.
    frames : int or None
        How many; None for as many as the plan says for each stop.
    pulses : PulseOrder or None
        Light that it needs; the light sheet is the investigation plane then, wherever the target is.
    glass_mm : (float, float, float)
        Displacement of the glass from its place in the scene.
    """

    tag: str
    target_mm: Vector = (0.0, 0.0, 0.0)
    view: str = CLEAR
    reference: int | None = None
    camera_mm: Vector = (0.0, 0.0, 0.0)
    frames: int | None = None
    pulses: PulseOrder | None = None
    glass_mm: Vector = (0.0, 0.0, 0.0)


class PlanTable(Table):
    """Base of every plan file."""

    experiment: str
    frames: Annotated[int, Field(ge=1, le=1_000_000)] = 1  # at each stop
    settle_s: Annotated[Annotated[float, Field(ge=0.0, le=600.0)], Usual(0.0, 60.0)] = 0.0
    # read by people
    notes: Annotated[dict[NoteKey, Note], Field(max_length=100)] = Field(default_factory=dict)
    needed: Annotated[list[str], Field(max_length=100)] = Field(
        default_factory=list
    )  # readings of the bench without which the run stops

    @property
    @abstractmethod
    def shows(self) -> str:
        """Pattern that has to hang on the target's stage: ``chessboard`` or ``particles``."""

    @property
    def frames_together(self) -> int:
        """Number of frames that belong together, such as the two of a pair."""
        return 1

    @property
    def share_of_gaps(self) -> float:
        """Share of a step's frames that may be lost; 0 takes a step again until it is whole."""
        return 0.0

    @property
    def further_cameras(self) -> tuple[str, ...]:
        """Cameras of the bench that take part beside `camera`."""
        return ()

    def questions(self, bench: Bench, steps: Sequence[Step]) -> Iterator[Question]:
        """Yield what few labs would ask of this bench: the place in the file, and the question."""
        yield from ()

    @abstractmethod
    def poses(self, bench: Bench) -> Iterator[Pose]:
        """Yield what is to be photographed, in order; nothing but arithmetic.

        Raises
        ------
        PlanError
            The bench cannot do it.
        """


def px_per_mm(bench: Bench) -> float:
    """Scale of the nominal camera on the plane, along its axis."""
    camera = bench.scene.camera
    along = float(camera.rotation_matrix[2][2])
    return camera.focal_px / abs(camera.position_mm[2] / along)
