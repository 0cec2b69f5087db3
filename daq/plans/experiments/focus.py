"""The focus scan: camera or target travel along z with a wide aperture, to find where each part is sharp.

    experiment: focus
    view: glass
    moves: camera                     # or target, which can only go back behind glass
    z_mm: [-10.0, 0.0, 10.0, 100.0, 110.0, 120.0, 130.0, 140.0]      # from the place in the scene
    f_number: 22.0                    # that the measurement is to be made with
    pixel_pitch_um: 11.0
    frames: 2                         # two tell noise from detail

Set the lens to its largest aperture (f/2.8) and do not touch its focus.  Glass moves the image of the plane:
behind two balls it comes to a focus 2.5 ball diameters before the plane, so no one setting is sharp everywhere,
and the aperture of the measurement has to be so small that its depth of field spans all best places
(`tracer.pupil`). `rtpiv focus RUN` says where they are, how deep the view is, and which f-number it
needs.
"""

from collections.abc import Iterator, Sequence
from typing import Annotated, Literal

from pydantic import Field, model_validator

from daq.bench.bench_table import Bench
from daq.plans.plan_table import PlanTable, Pose, Question, View
from daq.plans.steps import Step
from ground.usual import Usual
from stages.profile import Positive

MIN_FOCUS_PLACES = 5  # places that a best one can be found from


class FocusPlan(PlanTable):
    """A focus scan."""

    experiment: Literal["focus"]
    view: View = "glass"
    moves: Literal["camera", "target"] = "camera"
    z_mm: Annotated[list[float], Field(min_length=MIN_FOCUS_PLACES, max_length=10_000)]
    f_number: Annotated[Positive, Usual(0.95, 64.0)] = 22.0
    pixel_pitch_um: Annotated[Annotated[float, Field(ge=0.1, le=1000.0)], Usual(1.4, 30.0)]
    frames: Annotated[int, Field(ge=1, le=1000)] = 2

    @model_validator(mode="after")
    def _places_differ(self) -> "FocusPlan":
        if len(set(self.z_mm)) != len(self.z_mm):
            raise ValueError("z_mm names a place twice")
        return self

    @property
    def shows(self) -> str:
        """The particle sheet: spots whose width is known say how blurred they are."""
        return "particles"

    def poses(self, bench: Bench) -> Iterator[Pose]:
        """Yield one pose a place."""
        for z_mm in self.z_mm:
            way = (0.0, 0.0, z_mm)
            tag = f"focus_{self.view}_{self.moves}_z{z_mm:+g}mm"
            if self.moves == "camera":
                yield Pose(tag, view=self.view, camera_mm=way)
            else:
                yield Pose(tag, way, self.view)

    def questions(self, bench: Bench, steps: Sequence[Step]) -> Iterator[Question]:
        """Ask about places a long way off."""
        reach_mm = 0.3 * bench.scene.camera.position_mm[2]
        far = [s for s in steps if any(abs(mm - bench.home_mm[axis]) > reach_mm for axis, mm in s.positions_mm)]
        if far:
            text = f"z_mm: does {far[0].tag} go so far, more than {reach_mm:.3g} mm from the place in the scene?"
            yield ("z_mm",), text
