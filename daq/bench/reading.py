r"""Readings of the lab: what a gauge showed at every step of a run, such as a flow rate or a temperature.

    devices:
      flow: {kind: reading, unit: l/min, file: meter.csv}                # rows time,value that a program adds
      gas:  {kind: reading, unit: C, port: /dev/ttyUSB3, ask: "T?\r\n"}   # or a box that is asked, or streams

A reading serves people: it is in the journal and in the report, and moves nothing.  One that is silent, says no
number or is older than `oldest_s` is missing at that step, and a run goes on, unless its plan needs it.
"""

import math
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated, Any, Protocol, runtime_checkable

from pydantic import Field, model_validator

from ground.config import Table

NUMBER = r"([-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?)"
FOR_PORTS = {"baud", "ask", "find", "wait_s"}


class ReadingSection(Table):
    """Section of a bench file for a reading, without `kind`."""

    unit: Annotated[str, Field(max_length=20)]
    file: Annotated[str, Field(min_length=1)] | None = None
    port: Annotated[str, Field(min_length=1)] | None = None
    baud: Annotated[int, Field(ge=110, le=4_000_000)] = 9600
    ask: Annotated[str, Field(max_length=200)] = ""  # nothing: the box streams
    find: Annotated[str, Field(min_length=1, max_length=200)] = NUMBER  # its first group is the value
    column: Annotated[int, Field(ge=1, le=1000)] | None = None
    oldest_s: Annotated[float, Field(gt=0.0, le=86_400.0)] = 10.0
    wait_s: Annotated[float, Field(gt=0.0, le=60.0)] = 1.0

    @model_validator(mode="after")
    def _one_source(self) -> "ReadingSection":
        if (self.file is None) == (self.port is None):
            raise ValueError("a reading comes from a file or a port; set one")
        if self.file is not None and (more := FOR_PORTS & self.model_fields_set):
            raise ValueError(f"a file receives no query; remove {', '.join(sorted(more))}")
        if self.file is not None and self.column == 1:
            raise ValueError("column 1 of a file is the time of its rows; the value must be in another column")
        if self.port is not None and "oldest_s" in self.model_fields_set:
            raise ValueError("a port is read anew at every step, so leave oldest_s out")
        if self.column is not None and "find" in self.model_fields_set:
            raise ValueError("the value is in a column or found by find; set one")
        try:
            groups = re.compile(self.find).groups
        except re.error as error:
            raise ValueError(f"find is not a regular expression ({error})") from None
        if groups < 1:
            raise ValueError("find needs a group in brackets, which is the value, such as F=([0-9.]+)")
        return self


@dataclass(frozen=True)
class Reading:
    """A reading of a gauge.

    Parameters
    ----------
    unit : str
        Of the value.
    value : float
        NaN if it showed none.
    utc : str
        When; of a missing one, when it was looked for.
    missing : str
        Why there is none; "" if there is one.
    """

    unit: str
    value: float
    utc: str
    missing: str = ""

    def to_dict(self) -> dict[str, Any]:
        """As a line of the journal holds it: a missing value is absent."""
        record: dict[str, Any] = {"utc": self.utc, "unit": self.unit}
        return record | ({"missing": self.missing} if self.missing else {"value": self.value})


@runtime_checkable
class Gauge(Protocol):
    """Something that can be read."""

    def reading(self) -> Reading:
        """Return what it shows now; whatever goes wrong is a missing reading, never an error."""


def reading_of(section: ReadingSection, text: str, when: datetime) -> Reading:
    """Return what a field or the words of a box say."""
    utc = when.astimezone(UTC).isoformat(timespec="milliseconds")
    try:
        value = float(text)
    except ValueError:
        return Reading(section.unit, math.nan, utc, f"{text.strip()[:40]!r} is no number")
    if not math.isfinite(value):
        return Reading(section.unit, math.nan, utc, f"{text.strip()[:40]!r} is no value")
    return Reading(section.unit, value, utc)


def missing(section: ReadingSection, why: str) -> Reading:
    """Return that there is none."""
    return Reading(section.unit, math.nan, datetime.now(UTC).isoformat(timespec="milliseconds"), why)
