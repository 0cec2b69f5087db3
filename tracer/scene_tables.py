"""The sections of scene.yaml: what each may hold, and the camera, medium or body that it describes."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from tracer.bodies import Body, Core, Rod, Sphere
from tracer.camera import LONGEST_MM, Camera, Lens, Vector3, look_at, thin_lens_distance_mm
from tracer.config import Pair, Table, Triple
from tracer.errors import SceneError
from tracer.fit_section import FitTable
from tracer.media import MEDIA, AirMedium, ConstantMedium, Medium, SellmeierMedium, ShiftedMedium

Positive = Annotated[float, Field(gt=0.0, le=LONGEST_MM)]
OPAQUE = "opaque"


class SellmeierTable(Table):
    """Coefficients of a glass."""

    b: Annotated[list[float], Field(min_length=1, max_length=6)]
    c_um2: Annotated[list[float], Field(min_length=1, max_length=6)]

    @model_validator(mode="after")
    def _same_length(self) -> "SellmeierTable":
        if len(self.b) != len(self.c_um2):
            raise ValueError("b and c_um2 must have the same length")
        return self


class MediumTable(Table):
    """A medium by number, by formula, or as another one with a measured offset."""

    n: Annotated[float, Field(ge=1.0, le=5.0)] | None = None
    sellmeier: SellmeierTable | None = None
    base: str | None = None
    offset: Annotated[float, Field(ge=-1.0, le=1.0)] | None = None

    @model_validator(mode="after")
    def _one_of(self) -> "MediumTable":
        if (self.offset is not None) and self.base is None and self.sellmeier is None:
            raise ValueError("offset needs the glass that it is added to: base or sellmeier")
        if sum(given is not None for given in (self.n, self.sellmeier, self.base)) != 1:
            raise ValueError("give exactly one of n, sellmeier and base")
        return self

    def medium(self, name: str) -> Medium:
        """Return the medium described."""
        if self.n is not None:
            return ConstantMedium(float(self.n), name)
        if self.sellmeier is not None:
            own = SellmeierMedium(tuple(self.sellmeier.b), tuple(self.sellmeier.c_um2), name)
            return own if self.offset is None else ShiftedMedium(own, self.offset, name)
        known = MEDIA.get(self.base or "")
        if not isinstance(known, SellmeierMedium | AirMedium):
            named = [key for key, medium in MEDIA.items() if not isinstance(medium, ConstantMedium)]
            raise SceneError(f"unknown base {self.base!r}; known are {', '.join(sorted(named))}")
        return ShiftedMedium(known, self.offset or 0.0, name)


class LensTable(Table):
    """Distortion terms, acquired -> ideal."""

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    p1: float = 0.0
    p2: float = 0.0


class CameraTable(Table):
    """The camera section."""

    f_mm: Positive | None = None
    L_mm: Positive | None = None
    focal_px: Positive | None = None
    pixel_pitch_um: Annotated[float, Field(ge=1e-3, le=1e6)] | None = None
    sensor_px: Annotated[list[Annotated[int, Field(ge=1, le=65535)]], Field(min_length=2, max_length=2)]
    principal_px: Pair | None = None
    position_mm: Triple | None = None
    look_at_mm: Triple | None = None
    roll_deg: float | None = None
    rotation: Annotated[list[Triple], Field(min_length=3, max_length=3)] | None = None
    lens: LensTable = LensTable()

    @model_validator(mode="after")
    def _complete(self) -> "CameraTable":
        thin = self.f_mm is not None or self.L_mm is not None
        if thin == (self.focal_px is not None):
            raise ValueError("give either f_mm with L_mm and pixel_pitch_um, or focal_px")
        if thin and (self.f_mm is None or self.L_mm is None or self.pixel_pitch_um is None):
            raise ValueError("f_mm, L_mm and pixel_pitch_um belong together")
        if self.position_mm is None and self.L_mm is None:
            raise ValueError("position_mm is missing, and there is no L_mm to put the camera at")
        if self.rotation is not None and (self.look_at_mm is not None or self.roll_deg is not None):
            raise ValueError("give either rotation, or look_at_mm and roll_deg")
        return self

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
        lens = Lens(**self.lens.model_dump())
        return Camera(focal_px, (principal[0], principal[1]), (width, height), vector3(position), rotation, lens)


class CoreTable(Table):
    """What is inside a sphere, about the same centre; it may have a core itself."""

    radius_mm: Positive
    material: str | MediumTable
    core: "CoreTable | None" = None


class SphereTable(Table):
    """A sphere."""

    kind: Literal["sphere"]
    name: str | None = None
    centre_mm: Triple
    radius_mm: Positive
    material: str | MediumTable
    core: CoreTable | None = None

    def body(self, name: str, media: dict[str, Medium]) -> Body:
        """Return the sphere described.

        Raises
        ------
        SceneError
            It cannot be; names the part at fault, such as ``core``.
        """
        medium = None if self.material == OPAQUE else medium_of(self.material, media)
        return Sphere(name, vector3(self.centre_mm), self.radius_mm, medium, self._cores(name, media))

    def _cores(self, name: str, media: dict[str, Medium]) -> tuple[Core, ...]:
        """Cores from the outside in."""
        cores, table, part = [], self.core, "core"
        while table is not None:
            try:
                if table.material == OPAQUE:
                    raise SceneError(f"a core of sphere {name!r} cannot be opaque; give it a medium")
                cores.append(Core(table.radius_mm, medium_of(table.material, media)))
            except SceneError as error:
                raise SceneError(problems=[(f"{part}.material", str(error))]) from None
            table, part = table.core, f"{part}.core"
        return tuple(cores)


class RodTable(Table):
    """An opaque support."""

    kind: Literal["rod"]
    name: str | None = None
    start_mm: Triple
    end_mm: Triple
    radius_mm: Positive

    def body(self, name: str, media: dict[str, Medium]) -> Body:
        """Return the rod described."""
        return Rod(name, vector3(self.start_mm), vector3(self.end_mm), self.radius_mm)


BodyTable = Annotated[SphereTable | RodTable, Field(discriminator="kind")]


class SceneTable(Table):
    """A whole scene file."""

    wavelength_nm: Annotated[float, Field(ge=300.0, le=2000.0)] = 532.0
    ambient: str | MediumTable = MediumTable(n=1.0)
    glasses: dict[str, MediumTable] = Field(default_factory=dict)
    camera: CameraTable
    bodies: Annotated[list[BodyTable], Field(max_length=10_000)] = Field(default_factory=list)
    fit: FitTable = FitTable()


def vector3(values: list[float]) -> Vector3:
    """Three numbers as a tuple."""
    return (float(values[0]), float(values[1]), float(values[2]))


def medium_of(material: str | MediumTable, media: dict[str, Medium]) -> Medium:
    """Look up a medium by name, or build it.

    Raises
    ------
    SceneError
        The name is not known.
    """
    if isinstance(material, MediumTable):
        return material.medium("")
    if material not in media:
        raise SceneError(f"unknown medium {material!r}; known are {', '.join(sorted(media))}")
    return media[material]
