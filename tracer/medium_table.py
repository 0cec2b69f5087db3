"""A medium in a file: by name, by number, by formula, or as another one with a measured offset."""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field, model_validator

from ground.config import Table
from ground.plain_words import near
from ground.usual import Usual
from tracer.camera import LONGEST_MM
from tracer.errors import SceneError
from tracer.media import (
    COMMON_NAMES,
    MEDIA,
    AirMedium,
    ConstantMedium,
    Medium,
    SellmeierMedium,
    ShiftedMedium,
    media_names,
    medium_called,
)

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

    n: Annotated[Annotated[float, Field(ge=1.0, le=5.0)] | None, Usual(1.0, 2.1)] = None
    sellmeier: SellmeierTable | None = None
    base: str | None = None
    offset: Annotated[Annotated[float, Field(ge=-1.0, le=1.0)] | None, Usual(-0.05, 0.05)] = None

    @model_validator(mode="after")
    def _one_of(self) -> "MediumTable":
        if (self.offset is not None) and self.base is None and self.sellmeier is None:
            raise ValueError("offset needs the glass that it is added to: base or sellmeier")
        if sum(given is not None for given in (self.n, self.sellmeier, self.base)) != 1:
            raise ValueError("give exactly one of n, sellmeier and base")
        return self

    def medium(self, name: str) -> Medium:
        """Return the medium described.

        Raises
        ------
        SceneError
            The base is no glass of the catalogue, nor air; the message lists what is known.
        """
        if self.n is not None:
            return ConstantMedium(float(self.n), name)
        if self.sellmeier is not None:
            own = SellmeierMedium(tuple(self.sellmeier.b), tuple(self.sellmeier.c_um2), name)
            return own if self.offset is None else ShiftedMedium(own, self.offset, name)
        known = medium_called(self.base or "")
        if not isinstance(known, SellmeierMedium | AirMedium):
            named = [key for key, medium in MEDIA.items() if not isinstance(medium, ConstantMedium)]
            raise SceneError(f"unknown base {self.base!r}; known are {', '.join(sorted(named))}")
        return ShiftedMedium(known, self.offset or 0.0, name)


def medium_of(material: str | MediumTable, media: Mapping[str, Medium]) -> Medium:
    """Look up a medium by name, or build it.

    Raises
    ------
    SceneError
        The name is not known.
    """
    if isinstance(material, MediumTable):
        return material.medium("")
    found = medium_called(material, media)
    if found is None:
        hint = near(material, list(media)) or near(material.casefold(), list(COMMON_NAMES))
        hint = hint or f"; known are {media_names(media)}"
        raise SceneError(
            f"unknown medium {material!r}{hint} (or its index, as in {{n: 1.5}}; opaque blocks light)"
        )
    return found


def medium_entry(medium: Medium) -> str | dict[str, Any]:
    """Return a medium as a scene file has it."""
    if MEDIA.get(medium.name) == medium or isinstance(medium, AirMedium):
        return medium.name
    if isinstance(medium, ConstantMedium):
        return {"n": medium.index}
    if isinstance(medium, ShiftedMedium):
        base = medium_entry(medium.base)
        named = {"base": base} if isinstance(base, str) else base
        return {**named, "offset": medium.offset}
    return {"sellmeier": {"b": list(medium.b), "c_um2": list(medium.c_um2)}}
