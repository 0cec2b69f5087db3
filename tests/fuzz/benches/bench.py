"""A small bench of all five controllers on which nearly everything is in the way of everything.

A ball on the glass stage can be driven into the target, past its edge, and into the lens; the camera can be
driven onto the ball; the target into the ball. Where the axes stand after homing nothing obstructs anything.
Ways are short and axes fast, so that a sequence of commands takes little time.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from daq.bench.keep_out import Carrier, KeepOut, KeepOutTable
from sim.mechanics.clock import VirtualClock
from sim.stages import ScrewTable, SimulatedStages
from stages.config import StagesTable
from stages.errors import StageError
from stages.stage import Stage
from tracer.bodies import Sphere
from tracer.camera import Camera, look_at
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene


def _axis(controller, channel, carries, along, low_mm, high_mm, offset_mm, **more):
    usual = {
        "controller": controller, "channel": channel, "carries": carries, "along": along,
        "limits_mm": [low_mm, high_mm], "offset_mm": offset_mm, "speed_mm_s": 50.0, "acceleration_mm_s2": 500.0,
        "settle_s": 0.05, "approach": {"side": "from_below", "distance_mm": 0.5, "speed_mm_s": 5.0},
    }  # fmt: skip
    return {**usual, **more}


AXES = {
    "rail_z": _axis("rail", "X", "camera", "z", -60.0, 30.0, 35.0, sign=-1, steps_per_mm=100.0),
    "camera_x": _axis("portal", "X", "camera", "x", -30.0, 30.0, 35.0),
    "camera_y": _axis("portal", "Y", "camera", "y", -30.0, 30.0, 35.0),
    "glass_x": _axis("glass", "1/1", "glass", "x", -40.0, 40.0, -45.0, steps_per_mm=100.0),
    "glass_z": _axis("glass", "2/1", "glass", "z", -25.0, 40.0, -30.0, steps_per_mm=100.0),
    "target_x": _axis("side", "bay1", "target", "x", 5.0, 40.0, 0.0, steps_per_mm=100.0),
    "target_z": _axis("target", "1", "target", "z", -20.0, 25.0, -25.0),
}
TABLE = StagesTable.model_validate(
    {
        "controllers": {
            "rail": {"driver": "isel_dnc", "port": "a"}, "portal": {"driver": "grbl", "port": "b"},
            "glass": {"driver": "zaber_ascii", "port": "c"}, "target": {"driver": "pi_gcs2", "port": "d"},
            "side": {"driver": "thorlabs_apt", "port": "e"},
        },
        "axes": AXES,
        "home_order": ["rail_z", "glass_x", "glass_z", "target_x", "target_z", "camera_x", "camera_y"],
    }
)  # fmt: skip
SCREWS = {
    name: ScrewTable(
        lead_mm=4.0,
        steps_per_rev=400,
        travel_mm=axis["limits_mm"][1] - axis["limits_mm"][0] + 10.0,
        backlash_um=50.0,
        origin="high switch" if axis["controller"] == "portal" else "low switch",
    )
    for name, axis in AXES.items()
}
FIRMWARE = {
    "portal": {"settings": {23: 0, 24: 300.0, 25: 3000.0, 110: 3600.0, 111: 3600.0, 120: 500.0, 121: 500.0}}
}
KEEP_OUT = KeepOutTable(
    clearance_mm=2.0,
    target_size_mm=[60.0, 60.0, 5.0],
    camera_radius_mm=10.0,
    camera_ahead_mm=20.0,
    camera_behind_mm=20.0,
)
SCENE = Scene(
    Camera(1000.0, (9.5, 9.5), (20, 20), (0.0, 0.0, 110.0), look_at((0.0, 0.0, 110.0), (0.0, 0.0, 0.0))),
    (Sphere("ball", (0.0, 0.0, 25.0), 10.0, ConstantMedium(1.5, "glass")),),
)
CARRIERS = {name: Carrier(axis["carries"], axis["along"]) for name, axis in AXES.items()}
HOME_MM = dict.fromkeys(AXES, 0.0)


class TrapClock(VirtualClock):
    """A clock with traps at moments, sprung when somebody sleeps past them: mute lines have no bytes to count."""

    def __init__(self) -> None:
        super().__init__()
        self._traps: list[tuple[float, Callable[[], object]]] = []

    def after(self, seconds: float, action: Callable[[], object]) -> None:
        self._traps.append((self.now_s() + seconds, action))

    def clear(self) -> None:
        self._traps.clear()

    def sleep_s(self, duration_s: float) -> None:
        super().sleep_s(duration_s)
        if self._traps:
            now_s = self.now_s()
            due = [trap for trap in self._traps if trap[0] <= now_s]
            self._traps = [trap for trap in self._traps if trap[0] > now_s]
            for _, action in due:
                action()


@dataclass
class FuzzBench:
    """World, program and clock."""

    world: SimulatedStages
    clock: TrapClock
    offered: StagesTable
    is_guarded: bool = True
    stage: Stage = field(init=False)

    def start_program(self) -> None:
        """A new process: it knows nothing of what an older one did."""
        self.stage = Stage(
            self.offered, self.clock, KeepOut(SCENE, CARRIERS, KEEP_OUT) if self.is_guarded else None
        )
        for name in self.offered.controllers:
            try:
                self.stage.connect(name)
            except StageError:
                continue

    @property
    def lines(self):
        return self.world.lines


@contextmanager
def fuzz_bench(is_guarded: bool = True, clock: TrapClock | None = None) -> Iterator[FuzzBench]:
    """The bench, opened and homed."""
    clock = clock or TrapClock()
    world = SimulatedStages(TABLE, clock, SCREWS, FIRMWARE)
    world.witness.look_at(SCENE, KEEP_OUT, TABLE, HOME_MM)
    with world.in_process() as offered:
        bench = FuzzBench(world, clock, offered, is_guarded)
        bench.start_program()
        bench.stage.home()
        world.witness.judge()
        yield bench
        bench.stage.close()
