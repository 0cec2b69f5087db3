"""Kinds of devices that a bench can hold: one class each, one line in `KINDS`.

A kind says what a bench file says of one such device and opens it.  The sections `stages` and `camera` of a bench
file are the devices of these names; any more stand under `devices`, each with its `kind`:

    devices:
      second: {kind: camera, backend: aravis, options: {address: 192.168.10.8}}

A kind of another project is a dotted "package.module:Class".
"""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Annotated, Any, Protocol, cast

from pydantic import Field

from daq.bench.bench_table import Bench, CameraSection, NamedCameraSection
from daq.bench.guards import guard_of
from daq.cameras import make_camera
from daq.cameras.camera import Camera
from daq.cameras.double_height import DoubleHeightCamera
from daq.errors import RunUsageError
from daq.timing.drivers.pulse_box import PulseBox
from daq.timing.laser import Laser
from daq.timing.opened import open_laser
from daq.timing.timing_table import TimingTable
from ground.config import Table
from ground.named_program import UnknownName, program_of
from stages.clock import Clock
from stages.config import StagesTable
from stages.stage import Stage

KINDS = {
    "stage": "daq.bench.kinds:StageKind",
    "camera": "daq.bench.kinds:CameraKind",
    "timing": "daq.bench.kinds:TimingKind",
    "reading": "daq.bench.gauges:ReadingKind",
    "counter": "daq.bench.kinds:CounterKind",
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

    def places(self, section: Any) -> Iterator[str]:  # noqa: ANN401 - each kind has a section of its own
        """Say where another program finds it: ports, addresses, files."""


def kind_of(name: str) -> Kind:
    """Return the kind of that name.

    Raises
    ------
    RunUsageError
        There is none.
    """
    try:
        return cast("Kind", program_of(name, KINDS)())
    except UnknownName:
        raise RunUsageError(f"there is no kind of device {name!r}; there are {', '.join(KINDS)}") from None
    except (ImportError, AttributeError) as error:
        raise RunUsageError(f"the kind of device {name!r} cannot be loaded: {error}") from error


class StageKind:
    """The section `stages`."""

    section = StagesTable
    simulator = None  # the world carries things on its own axes

    def open(self, section: StagesTable, bench: Bench, clock: Clock) -> AbstractContextManager[Stage]:
        """Connect every controller; leaving stops what moves."""
        return Stage.open(section.beside(bench.path.parent), clock, guard_of(bench))

    def places(self, section: StagesTable) -> Iterator[str]:
        """Ports of the controllers."""
        for name, controller in section.controllers.items():
            yield f"controller {name}: {controller.driver} on {controller.place}"


class CameraKind:
    """The section `camera`, and every further camera under `devices`."""

    section = NamedCameraSection
    simulator = None  # its eyes are the world's

    @contextmanager
    def open(self, section: CameraSection, bench: Bench, clock: Clock) -> Iterator[Camera]:
        """Open it, not yet configured."""
        camera = make_camera(section.backend, **section.options)
        if section.pairs is not None and section.pairs.shape == "double_height":
            camera = cast("Camera", DoubleHeightCamera(camera))
        try:
            camera.open()
            yield camera
        finally:
            camera.close()

    def places(self, section: CameraSection) -> Iterator[str]:
        """Producer or address."""
        options = section.options
        named = (("cti", "GenTL producer"), ("address", "GigE Vision at"), ("device_id", "USB3 Vision"))
        where = [f"{words} {options[key]}" for key, words in named if key in options]
        where += [f"{section.backend} {' '.join(str(value) for value in options.values())}"]
        yield f"camera: {where[0]}"


class TimingKind:
    """A device of kind `timing`."""

    section = TimingTable
    simulator = "sim.devices:simulate_timing"

    def open(self, section: TimingTable, bench: Bench, clock: Clock) -> AbstractContextManager[Laser]:
        """Switch everything off and read it back; leaving does the same."""
        return open_laser(section, clock)

    def places(self, section: TimingTable) -> Iterator[str]:
        """Port of the box."""
        yield f"timing unit: {section.box} on {section.port}"


class CounterSection(Table):
    """A pulse box that counts."""

    port: Annotated[str, Field(min_length=1)]


class CounterKind:
    """A device of kind `counter`, for `rtpiv laser prove`."""

    section = CounterSection
    simulator = "sim.devices:simulate_counter"

    @contextmanager
    def open(self, section: CounterSection, bench: Bench, clock: Clock) -> Iterator[PulseBox]:
        """Connect it."""
        box = PulseBox(f"counter on {section.port}", clock)
        try:
            box.connect(section.port)
            yield box
        finally:
            box.close()

    def places(self, section: CounterSection) -> Iterator[str]:
        """Port of the box."""
        yield f"pulse counter on {section.port}"
