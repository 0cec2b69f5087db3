"""Faults of a simulated bench: the keys of a faults file.

faults:
  - {what: unplug, of: target, step: 7}                  # the cable comes out as step 7 of the run begins
  - {what: late, of: glass, word: "move abs", delay_s: 0.3}   # the answer to these bytes, said for the first time
  - {what: cut, of: camera, step: 3}                     # the next frame arrives torn
  - {what: knock, of: glass_x, at_s: 40.0, by_mm: 0.4}   # something hits a carriage, 40 s of the bench's time on
  - {what: dim, of: lamp, step: 2, share: 0.6}           # from then on 0.6 of the light

======  ===================  ==============================================================================
of      what                 meaning
======  ===================  ==============================================================================
a box   unplug               its cable is out until the bench is opened again
        mute                 it obeys commands, and does not answer any more
        restart              its power fails, and is back `off_s` later: it has forgotten where it is
        late, split          its next answer comes `delay_s` later; or the second half of it does
        lost, cut, doubled,  its next answer does not come, or half of it, or twice, or with a wrong byte
        garbled
timing  the same, and        a person presses the key STOP of the box, or its key RUN, or opens the switches of
unit    stop, run, door,     door and key, or another program sends off to the box past the one that holds its
        off                  port; from then on no light may leave until RUN is pressed
camera  unplug               it is gone until the bench is opened again
        late                 the next frame leaves it `delay_s` later
        lost, cut, doubled   the next frame does not come, or with a part of its pixels missing, or twice
axis    knock                its carriage slips by `by_mm`, which no controller can know
        stall                its motor is stuck from then on, whatever is commanded
lamp    dim                  the target has this `share` of its light from then on
======  ===================  ==============================================================================

A box is a controller of the stages, a timing unit or a reading.  `nth` waits until a word has been said so often.
"""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from daq.bench.bench_table import STAGES, Bench, CameraSection
from daq.timing.timing_table import TimingTable
from ground.config import Table

What = Literal[
    "unplug", "mute", "restart", "late", "split", "lost", "cut", "doubled", "garbled", "stop", "run", "door",
    "off", "knock", "stall", "dim",
]  # fmt: skip
OF_A_BOX = ("unplug", "mute", "restart", "late", "split", "lost", "cut", "doubled", "garbled")
OF_A: dict[str, tuple[str, ...]] = {
    "box": OF_A_BOX,
    "timing unit": (*OF_A_BOX, "stop", "run", "door", "off"),
    "camera": ("unplug", "late", "lost", "cut", "doubled"),
    "axis": ("knock", "stall"),
    "lamp": ("dim",),
}
LAMP = "lamp"
TAKES = {"late": "delay_s", "split": "delay_s", "restart": "off_s", "knock": "by_mm", "dim": "share"}
NUMBERS = ("delay_s", "off_s", "by_mm", "share")
MOMENTS = ("step", "at_s", "word")
Text = Annotated[str, Field(min_length=1, max_length=200)]


class Fault(Table):
    """One fault; see the module's text."""

    what: What
    of: Annotated[str, Field(min_length=1, max_length=100)]
    step: Annotated[int, Field(ge=1)] | None = None
    at_s: Annotated[float, Field(ge=0.0)] | None = None
    word: Text | None = None
    nth: Annotated[int, Field(ge=1)] = 1
    delay_s: Annotated[float, Field(gt=0.0, le=600.0)] | None = None
    off_s: Annotated[float, Field(gt=0.0, le=600.0)] | None = None
    by_mm: Annotated[float, Field(ge=-1000.0, le=1000.0)] | None = None
    share: Annotated[float, Field(ge=0.0, le=2.0)] | None = None

    @property
    def moment(self) -> str:
        """Moment at which it is due, in words."""
        if self.step is not None:
            return f"step {self.step}"
        if self.at_s is not None:
            return f"{self.at_s:g} s"
        return f"word {self.word!r}" + (f", time {self.nth}" if self.nth > 1 else "")


class FaultFile(Table):
    """A file of faults."""

    faults: Annotated[list[Fault], Field(min_length=1, max_length=1000)]


def things_of(bench: Bench) -> dict[str, str]:
    """Everything of a bench that a fault can be of: its name, and which of `OF_A` it is."""
    things = dict.fromkeys(bench.table.stages.controllers, "box") | dict.fromkeys(bench.table.stages.axes, "axis")
    for name, device in bench.devices.items():
        if name != STAGES:
            kinds = {CameraSection: "camera", TimingTable: "timing unit"}
            things[name] = next((kind for made, kind in kinds.items() if isinstance(device.section, made)), "box")
    return things | {LAMP: "lamp"}


def validation_errors(fault: Fault, bench: Bench) -> Iterator[str]:
    """Say what of a fault cannot be on a bench, a sentence each."""
    things = things_of(bench)
    thing = things.get(fault.of)
    if thing is None:
        yield f"of: there is no {fault.of!r} on this bench; there are {', '.join(things)}"
        return
    if fault.what not in OF_A[thing]:
        yield f"what: {fault.of} is a {thing}, which cannot {fault.what}; say one of {', '.join(OF_A[thing])}"
        return
    if sum(getattr(fault, name) is not None for name in MOMENTS) != 1:
        yield f"{fault.what} of {fault.of}: say when, by one of {', '.join(MOMENTS)}"
    if fault.word is not None and thing not in ("box", "timing unit", "axis"):
        yield f"word: a {thing} gets no commands on a port; give step or at_s"
    if fault.nth > 1 and fault.word is None:
        yield "nth: it counts how often a word is said; say word, or leave nth out"
    wanted = TAKES.get(fault.what)
    for name in NUMBERS:
        given = getattr(fault, name) is not None
        if given and name != wanted:
            yield f"{name}: {fault.what} takes no such number; leave it out"
        elif name == wanted and not given:
            yield f"{fault.what} of {fault.of}: say {name} as well"
