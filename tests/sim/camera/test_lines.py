"""Input lines: which was high when, pulses over a wire, and exposures since a reset."""

import time

from sim.camera.exposure import RESET_LINE, Lines
from sim.camera.wires import Wires, listen


def test_a_level_holds_from_its_rise_up_to_its_fall():
    lines = Lines()
    lines.note(0, 100, 200)
    lines.note(2, 150, 160)
    lines.note(9, 0, 1000)  # the camera has no such line
    assert [lines.status(at) for at in (99, 100, 150, 159, 160, 199, 200)] == [0, 1, 5, 5, 1, 1, 0]


def test_exposures_are_counted_from_the_last_reset():
    lines = Lines()
    counts = []
    for at_ns in (10, 20, 30, 110, 120, 210):
        if at_ns % 100 == 10:
            lines.note(RESET_LINE, at_ns, at_ns + 5)
        lines.expose(at_ns)
        counts.append(lines.exposures_since(RESET_LINE, at_ns))
    assert counts == [1, 2, 3, 1, 2, 1]


def test_pulses_arrive_in_order_with_their_edges(tmp_path):
    wires, heard = Wires(tmp_path), []
    listen(str(wires.path), lambda *pulse: heard.append(pulse))
    end_s = time.monotonic() + 5.0
    while not wires._cameras and time.monotonic() < end_s:
        time.sleep(0.001)
    for number in range(100):
        wires.pulse(1 + number % 2, number, number + 5)
    while len(heard) < 100 and time.monotonic() < end_s:
        time.sleep(0.001)
    assert heard == [(1 + number % 2, number, number + 5) for number in range(100)]
    wires.close()
    wires.pulse(1, 0, 1)  # nobody listens any more
