"""Kinds of devices that a bench can hold: one file each, one line here.

A kind says what a bench file says of one such device and opens it.  The sections `stages` and `camera` of a bench
file are the devices of these names; any more stand under `devices`, each with its `kind`:

    devices:
      second: {kind: camera, backend: aravis, options: {address: 192.168.10.8}}

A kind of another project is a dotted "package.module:Class".
"""

from collections.abc import Iterator
from contextlib import AbstractContextManager
from importlib import import_module
from typing import Any, Protocol, cast

from daq.bench.bench_table import Bench
from daq.errors import RunUsageError
from ground.config import Table
from ground.named_program import named_program
from stages.clock import Clock

KINDS = {
    "stage": "daq.bench.stage_kind:StageKind",
    "camera": "daq.bench.camera_kind:CameraKind",
    "timing": "daq.bench.timing_kind:TimingKind",
}


class Kind(Protocol):
    """A kind of device.

    Attributes
    ----------
    section : type of Table
        What the bench file says of one, without `kind`.
    simulator : str or None
        "package.module:function" that puts a simulated one up: called with section, world and clock it returns a
        context that yields the section to open instead.  None if only the world itself has one.
    """

    section: type[Table]
    simulator: str | None

    def open(self, section: Any, bench: Bench, clock: Clock) -> AbstractContextManager[object]:  # noqa: ANN401
        """Open one for the length of the context.

        Entering moves nothing and switches nothing on; leaving stops what moves, switches off what radiates, and
        closes it, whatever has happened.  What is not there is a DaqError or StageError that says so.
        """
        ...

    def places(self, section: Any) -> Iterator[str]:  # noqa: ANN401 - each kind has a section of its own
        """Say where another program finds it: ports, addresses, files."""
        ...


def kind_of(name: str) -> Kind:
    """Return the kind of that name.

    Raises
    ------
    RunUsageError
        There is none.
    """
    module, colon, attribute = KINDS.get(name, name).partition(":")
    if not colon:
        raise RunUsageError(f"there is no kind of device {name!r}; there are {', '.join(KINDS)}")
    try:
        kind = getattr(import_module(module), attribute) if name in KINDS else named_program(name)
        return cast("Kind", kind())
    except (ImportError, AttributeError) as error:
        raise RunUsageError(f"the kind of device {name!r} cannot be loaded: {error}") from error
