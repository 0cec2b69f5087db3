"""Double-frame cameras: arrival of pairs and the marker of exposure A (key `pairs` of a camera).

=============  ==============================================================================================
shape          how the exposures A and B of a pair arrive
=============  ==============================================================================================
double_height  one buffer of twice the height, A on top (double-shutter cameras behind frame grabbers)
two_blocks     one trigger, two frames: B begins when A ends and lasts as long as A takes to be read out
straddling     a camera without a double shutter: A and B are frames of their own, each with its trigger
burst          one trigger starts a burst of two frames
=============  ==============================================================================================

Frames that come evenly spaced cannot be distinguished by their times, and one frame that is skipped (first ones
often are) would swap A and B for the rest of the run.  So A is known by a marker, or the run is refused:

=============  ==============================================================================================
marker         A is the frame ...
=============  ==============================================================================================
halves         on top of the buffer; of double_height, which needs no other
line_status    whose chunk LineStatusAll has the bit of `line` set: wire a pulse that covers exposure A to it
counter        whose chunk `counter` says `first`, such as FramesPerTriggerCounter, or a counter reset by T0
spacing        after which the next frame comes soonest: A to B is shorter than B to A by more than 10 %
=============  ==============================================================================================
"""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from ground.config import Table
from ground.usual import Usual
from stages.profile import Positive

Shape = Literal["double_height", "two_blocks", "straddling", "burst"]
Marker = Literal["halves", "line_status", "counter", "spacing"]
SPACING_RATIO = 1.1  # times A to B that B to A has to last, or their spacing tells nothing
FRAMES_OF_SHAPE = {"double_height": 1, "two_blocks": 2, "straddling": 2, "burst": 2}


class PairsSection(Table):
    """Arrival of pairs."""

    shape: Shape
    marker: Marker | None = None
    line: Annotated[int, Field(ge=0, le=63)] | None = None
    counter: Annotated[str, Field(min_length=1)] | None = None
    first: Annotated[int, Field(ge=0, le=1_000_000)] = 1
    dead_us: Annotated[
        Annotated[float, Field(ge=0.0, le=1e6)], Usual(0.0, 1e3)
    ]  # from the end of exposure A to the start of exposure B
    start_delay_us: Annotated[Annotated[float, Field(ge=0.0, le=1e6)], Usual(0.0, 1e3)] = (
        0.0  # from the trigger to the start of exposure A
    )
    margin_us: Annotated[Annotated[float, Field(ge=0.0, le=1e5)], Usual(0.0, 100.0)] = (
        2.0  # between light and either end of an exposure
    )
    second_exposure_us: Positive | None = None  # of B, where the camera decides it
    most_hz: Annotated[Positive | None, Usual(0.5, 1e4)] = None  # pairs a second that the camera can take

    @model_validator(mode="after")
    def _can_be_told_apart(self) -> "PairsSection":
        is_one_buffer = self.shape == "double_height"
        if (self.marker or "halves") != "halves" and is_one_buffer:
            raise ValueError("double_height has A on top of B in one buffer; leave the marker out")
        if not is_one_buffer and self.marker in (None, "halves"):
            raise ValueError(
                f"A and B need a marker; set one for {self.shape} frames: line_status, counter or spacing"
            )
        for marker, key in (("line_status", "line"), ("counter", "counter")):
            if self.marker == marker and getattr(self, key) is None:
                raise ValueError(f"marker {marker} needs {key}")
        if self.shape in ("straddling", "burst") and self.second_exposure_us is not None:
            raise ValueError(f"A and B of {self.shape} frames have one exposure; leave second_exposure_us out")
        return self

    @property
    def effective_marker(self) -> Marker:
        """The marker, also where the shape is one."""
        return self.marker or "halves"

    @property
    def chunks(self) -> tuple[str, ...]:
        """Chunk data that every frame has to carry, by their SFNC names."""
        names = {"line_status": "LineStatusAll", "counter": self.counter or ""}
        return (names[self.effective_marker],) if self.effective_marker in names else ()

    @property
    def frames(self) -> int:
        """Frames that the camera sends for a pair."""
        return FRAMES_OF_SHAPE[self.shape]
