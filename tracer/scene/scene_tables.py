"""The sections of scene.yaml: what each may hold, and the camera, medium or body that it describes."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, Union

import numpy as np
from pydantic import Field, field_validator, model_validator

from ground.config import Pair, Table, Triple
from ground.memory import MOST_PX
from ground.plain_words import exactly, slip
from ground.usual import Usual
from tracer.bodies import KINDS, BodySection, vector3
from tracer.camera import Camera, Lens, look_at, thin_lens_distance_mm
from tracer.errors import SceneError
from tracer.light_sheet import STEEPEST_DEG, UNMEASURED_DEG, UNMEASURED_MM, WIDEST_FAN_DEG, LightSheet, SheetSource
from tracer.masked import LEFT_OUT, MaskedPart, left_out
from tracer.medium_table import MediumTable, Positive
from tracer.pupil import Pupil
from tracer.scene.fit_section import FitTable, Sigma

MOST_OFF_PX = 1e5  # from pixel (0, 0) to the optical axis, of a part of the longest line camera as well


class LensTable(Table):
    """Distortion terms, acquired -> ideal."""

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    p1: float = 0.0
    p2: float = 0.0


PlacePx = Annotated[float, Field(ge=-MOST_OFF_PX, le=MOST_OFF_PX)]


SensorTilt = Annotated[float, Field(ge=-80.0, le=80.0)]


class CameraTable(Table):
    """The camera section."""

    f_mm: Annotated[Annotated[float, Field(ge=0.1, le=1e5)] | None, Usual(4.0, 1500.0)] = None
    L_mm: Annotated[Positive | None, Usual(5.0, 20000.0)] = None
    focal_px: Positive | None = None
    pixel_pitch_um: Annotated[Annotated[float, Field(ge=0.1, le=1000.0)] | None, Usual(1.4, 30.0)] = None
    sensor_px: Annotated[
        list[Annotated[int, Field(ge=1, le=65535)]], Field(min_length=2, max_length=2), exactly(2)
    ]
    principal_px: Annotated[list[PlacePx], Field(min_length=2, max_length=2), exactly(2)] | None = None
    position_mm: Triple | None = None
    look_at_mm: Triple | None = None
    roll_deg: Annotated[Annotated[float, Field(ge=-360.0, le=360.0)] | None, Usual(-180.0, 180.0)] = None
    rotation: Annotated[list[Triple], Field(min_length=3, max_length=3), exactly(3)] | None = None
    sensor_tilt_deg: Annotated[list[SensorTilt], Field(min_length=2, max_length=2), exactly(2)] | None = None
    mirrored: bool = False
    lens: LensTable = LensTable()
    f_number: Annotated[Annotated[float, Field(ge=0.5, le=1000.0)] | None, Usual(0.95, 64.0)] = None
    pupil_mm: Positive | None = None
    focus_mm: Positive | None = None

    @field_validator("sensor_px")
    @classmethod
    def _some_camera_has_it(cls, value: list[int]) -> list[int]:
        if value[0] * value[1] > MOST_PX:
            raise ValueError(f"{value[0]} x {value[1]} px is more than the {MOST_PX} that any camera has")
        return value

    @model_validator(mode="after")
    def _complete(self) -> "CameraTable":
        thin = self.f_mm is not None or self.L_mm is not None
        if thin == (self.focal_px is not None):
            raise ValueError("give either f_mm with L_mm and pixel_pitch_um, or focal_px")
        if thin and (self.f_mm is None or self.L_mm is None or self.pixel_pitch_um is None):
            raise ValueError("f_mm, L_mm and pixel_pitch_um belong together")
        if self.position_mm is None and self.L_mm is None:
            raise ValueError("position_mm is missing, and there is no L_mm to put the camera at")
        if self.f_mm is not None and self.focus_mm is not None and self.focus_mm <= self.f_mm:
            hint = slip("focus_mm", self.focus_mm, 2.0 * self.f_mm, 100.0 * self.f_mm)
            raise ValueError(f"a lens of {self.f_mm:g} mm is never in focus at focus_mm {self.focus_mm:g}{hint}")
        if self.rotation is not None and (self.look_at_mm is not None or self.roll_deg is not None):
            raise ValueError("give either rotation, or look_at_mm and roll_deg")
        if self.f_number is not None and (self.f_mm is None or self.pupil_mm is not None):
            raise ValueError("f_number goes with f_mm; with focal_px give the pupil's diameter, pupil_mm")
        if self.focus_mm is not None and self.f_number is None and self.pupil_mm is None:
            raise ValueError("focus_mm says nothing without f_number or pupil_mm")
        if self.pupil_mm is not None and self.focus_mm is None and self.L_mm is None:
            raise ValueError("pupil_mm needs focus_mm, the distance from the pinhole to the plane in focus")
        return self

    def pupil(self) -> Pupil | None:
        """Return the pupil described; None if no aperture is given."""
        diameter_mm = self.pupil_mm
        if self.f_number is not None:
            assert self.f_mm
            diameter_mm = self.f_mm / self.f_number
        return None if diameter_mm is None else Pupil(0.5 * diameter_mm, float(self.focus_mm or self.L_mm or 0.0))

    def camera(self) -> Camera:
        """Return the camera described."""
        if self.focal_px is not None:
            focal_px = self.focal_px
        else:
            assert self.f_mm
            assert self.L_mm
            assert self.pixel_pitch_um
            focal_px = thin_lens_distance_mm(self.f_mm, self.L_mm) / (self.pixel_pitch_um * 1e-3)
        width, height = self.sensor_px
        principal = self.principal_px or [(width - 1) / 2.0, (height - 1) / 2.0]
        position = self.position_mm or [0.0, 0.0, float(self.L_mm or 0.0)]
        if self.rotation is not None:
            first, second, third = (vector3(row) for row in self.rotation)
            rotation = (first, second, third)
        else:
            roll_rad = float(np.deg2rad(self.roll_deg or 0.0))
            rotation = look_at(vector3(position), vector3(self.look_at_mm or [0.0, 0.0, 0.0]), roll_rad)
        if np.linalg.det(np.array(rotation)) < 0.0:
            raise SceneError(
                "the camera's rotation must be right-handed; for frames that are mirror images give mirrored: true"
            )
        lens = Lens(**self.lens.model_dump())
        camera = Camera(
            focal_px,
            (principal[0], principal[1]),
            (width, height),
            vector3(position),
            rotation,
            lens,
            self.pupil(),
        )
        tilt_x, tilt_y = np.deg2rad(self.sensor_tilt_deg or (0.0, 0.0)).tolist()
        camera = camera.with_tilted_sensor(tilt_x, tilt_y)
        return camera.mirrored() if self.mirrored else camera


if TYPE_CHECKING:
    AnyBody = BodySection
else:
    AnyBody = Annotated[Union[tuple(kind.Section for kind in KINDS)], Field(discriminator="kind")]  # noqa: UP007


Tilt = Annotated[float, Field(ge=-STEEPEST_DEG, le=STEEPEST_DEG)]
Correlation = Annotated[float, Field(ge=-1.0, le=1.0)]


FanAngle = Annotated[float, Field(ge=0.0, le=WIDEST_FAN_DEG)]


class SourceTable(Table):
    """A source of the light of a sheet."""

    from_deg: Annotated[float, Field(ge=-360.0, le=360.0)]
    width_mm: Positive
    profile: Literal["uniform", "gaussian"] = "uniform"
    fan_deg: FanAngle = 0.0
    divergence_deg: FanAngle = 0.0
    focus_mm: Annotated[float, Field(ge=-1e5, le=1e5)] = 0.0
    power: Positive = 1.0

    def source(self) -> SheetSource:
        """Return the source described."""
        return SheetSource(**self.model_dump(exclude={"profile"}), gaussian=self.profile == "gaussian")


class SheetTable(Table):
    """The light sheet: where particles are lit."""

    z_mm: Annotated[float, Field(ge=-1e4, le=1e4)] = 0.0
    tilt_x_deg: Annotated[Tilt, Usual(-5.0, 5.0)] = 0.0
    tilt_y_deg: Annotated[Tilt, Usual(-5.0, 5.0)] = 0.0
    sigma_mm: Annotated[Sigma, Usual(0.0, 2.0)] = UNMEASURED_MM
    tilt_sigma_deg: Annotated[Sigma, Usual(0.0, 2.0)] = UNMEASURED_DEG
    correlation: Annotated[list[Correlation], Field(min_length=3, max_length=3), exactly(3)] | None = None
    thickness_mm: Positive | None = None
    sources: Annotated[list[SourceTable], Field(max_length=8)] = Field(default_factory=list)

    def light_sheet(self) -> LightSheet:
        """Return the sheet described."""
        said = self.model_dump(exclude={"correlation", "sources"})
        sources = tuple(source.source() for source in self.sources)
        return LightSheet(**said, correlation=vector3(self.correlation or (0.0, 0.0, 0.0)), sources=sources)


class MaskedTable(Table):
    """A part of the view that is not to be used."""

    why: Literal["unlisted body", "unconfirmed", "left out"]
    outline_px: Annotated[list[Pair], Field(max_length=100_000)] = Field(default_factory=list)
    through: Annotated[list[str], Field(max_length=1000)] = Field(default_factory=list)
    outline_mm: Annotated[list[Pair], Field(max_length=100_000)] = Field(default_factory=list)
    picture: Annotated[str, Field(min_length=1, max_length=1000)] | None = None

    def parts(self, folder: Path, sensor_px: tuple[int, int] | None) -> tuple[MaskedPart, ...]:
        """Return the parts described: one, or those of a picture, which stands beside the scene file in a folder.

        Raises
        ------
        SceneError
            They are none, or the picture is not one of this camera's frame.
        """
        if self.picture is None:
            points = (tuple((a, b) for a, b in outline) for outline in (self.outline_px, self.outline_mm))
            in_frame, in_plane = points
            return (MaskedPart(self.why, in_frame, tuple(self.through), in_plane),)
        if self.outline_px or self.through or self.outline_mm:
            raise SceneError("masked: give outline_px, outline_mm, through or picture, one of them")
        if self.why != LEFT_OUT:
            raise SceneError(f"masked: a picture says what is {LEFT_OUT!r}")
        return () if sensor_px is None else left_out(folder / self.picture, sensor_px)


class SceneTable(Table):
    """A whole scene file."""

    wavelength_nm: Annotated[float, Field(ge=300.0, le=2000.0)] = 532.0
    ambient: str | MediumTable = MediumTable(n=1.0)
    glasses: dict[str, MediumTable] = Field(default_factory=dict)
    camera: CameraTable
    bodies: Annotated[list[AnyBody], Field(max_length=1000)] = Field(default_factory=list)
    sheet: SheetTable | None = None
    masked: Annotated[list[MaskedTable], Field(max_length=1000)] = Field(default_factory=list)
    fit: FitTable = FitTable()
