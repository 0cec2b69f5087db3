"""What hangs on the simulated timing unit: the camera's input lines, and the light that falls on the flow.

    camera, camera_b -> Line1 (a trigger)     marker -> Line2 (high over exposure A; resets the exposure counter)
    Q-switches -> flashes, the laser's own delay later

A camera lives in another process and draws its picture as soon as it has been exposed.  So its pulses are told
`LAG_S` late, when all light of that time has fallen; their edges stay where they were.  The marker is told first:
a frame that its trigger has made is judged by it.
"""

from collections import deque

from daq.timing.pulses import Q_SWITCHES, Role
from daq.timing.timing_table import TimingTable
from sim.camera.wires import Wires
from sim.lit_flow import LitFlow
from sim.mechanics.clock import PacedClock, ScaledClock
from sim.timing import SimulatedTiming
from sim.timing_boxes.outputs import Pulse

TRIGGER_LINE, MARKER_LINE = 1, 2
LAG_S = 0.03  # more than an exposure lasts


def connect(
    unit: SimulatedTiming, table: TimingTable, clock: PacedClock | ScaledClock, wires: Wires, lit: LitFlow | None
) -> None:
    """Hang camera and light on a timing unit.

    Parameters
    ----------
    unit : SimulatedTiming
        The unit.
    table : TimingTable
        Its section, for the delay from a Q-switch to its light.
    clock : PacedClock or ScaledClock
        The world's, that pulses are told on.
    wires : Wires
        To the camera.
    lit : LitFlow or None
        What the light falls on.
    """
    coming: deque[tuple[float, int, int, int]] = deque()  # rise on the world's clock, line, rise, fall [ns]

    def hold(line: int, pulse: Pulse) -> None:
        edges_ns = (clock.wall_ns(pulse.rises_s), clock.wall_ns(pulse.falls_s))
        coming.append((pulse.rises_s, line, *edges_ns))

    def tell(until_s: float) -> None:
        due = []
        while coming and coming[0][0] + LAG_S <= until_s:
            due.append(coming.popleft())
        for _, line, rise_ns, fall_ns in sorted(due, key=lambda pulse: (pulse[2], -pulse[1])):
            wires.pulse(line, rise_ns, fall_ns)

    unit.listen(Role.MARKER, lambda pulse: hold(MARKER_LINE, pulse))
    for role in (Role.CAMERA, Role.CAMERA_B):
        unit.listen(role, lambda pulse: hold(TRIGGER_LINE, pulse))
    unit.listen_to_time(tell)
    if lit is None:
        return
    for number, role in enumerate(Q_SWITCHES):
        delay_s = 1e-6 * table.head.head().q_switch_to_light_us[number]

        def flash(pulse: Pulse, number: int = number, delay_s: float = delay_s) -> None:
            lit.flash(number, clock.wall_ns(pulse.rises_s + delay_s))

        unit.listen(role, flash)
