"""QMI's driver of the 9530, which is used on real boxes, on our box: a tool of a bench that nothing here needs."""

import time

import pytest

from sim.emulators.line import Line
from sim.emulators.pty import PtyPort
from sim.mechanics.clock import ScaledClock, VirtualClock
from sim.timing_boxes.quantum_composers import QuantumComposersEmulator, Variant


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_qmi_sets_reads_and_fires_a_9530():
    qmi = pytest.importorskip("qmi", reason="qmi is not installed")
    from qmi.instruments.quantum_composers import pulse_generator9530 as theirs

    clock = ScaledClock(1.0)
    box = QuantumComposersEmulator(clock)
    with PtyPort(Line(box, clock)) as port:
        qmi.start("bench")
        try:
            driver = theirs.QuantumComposers_PulseGenerator9530
            client = qmi.make_instrument("box", driver, f"serial:{port.path}")
            client.open()
            client.reset()
            assert client.get_idn().model == "9538"
            assert client.get_num_channels() == 8
            client.set_refclk_source(theirs.RefClkSource.EXTPLL)
            assert client.is_refclk_pll_locked()
            client.set_display_enabled(True)
            client.set_trigger_mode(theirs.TriggerMode.DISABLED)
            for name, value in (("t0_period", 0.02), ("t0_mode", theirs.PulseMode.NORMAL), ("t0_burst_count", 3)):
                getattr(client, f"set_{name}")(value)
                assert getattr(client, f"get_{name}")() == value
            assert client.get_trigger_mode() is theirs.TriggerMode.DISABLED
            for name, value in (
                ("channel_width", 1e-5), ("channel_delay", 1e-4), ("channel_mode", theirs.PulseMode.BURST),
                ("channel_burst_count", 5), ("output_inverted", False), ("channel_enabled", True),
            ):  # fmt: skip
                getattr(client, f"set_{name}")(2, value)
                assert getattr(client, f"get_{name}")(2) == value
            client.set_output_enabled(True)
            assert client.get_output_enabled()
            time.sleep(0.5)
            client.set_output_enabled(False)
            box.advance()
            assert box.outputs.count["B"] == 5
            client.close()
        finally:
            qmi.stop()


@pytest.mark.parametrize(("mode", "ticks"), [("NORM", 1), ("SING", 1), ("BURS", 4)])
def test_a_box_that_waits_for_its_trigger_is_given_one_by_a_word(mode, ticks):
    """*TRG, which bnc575_delay_generator says; whoever waits for no trigger is refused."""
    clock = VirtualClock()
    box = QuantumComposersEmulator(clock, Variant("BNC,575-8"))
    heard = []
    box.say = heard.append

    def says(*lines):
        heard.clear()
        for line in lines:
            box.feed(f"{line}\r\n".encode())
        return heard

    assert says("*TRG") == [b"?8\r\n"]
    lines = ":PULS0:TRIG:MOD TRIG", f":PULS0:MOD {mode}", ":PULS0:BCO 4", ":PULS2:STAT 1", ":PULS0:STAT 1"
    assert set(says(*lines)) == {b"ok\r\n"}
    clock.sleep_s(1.0)
    box.advance()
    assert box.outputs.count["B"] == 0
    for rounds in (1, 2):
        assert says("*TRG") == [b"ok\r\n"]
        clock.sleep_s(2.0)
        box.advance()
        assert box.outputs.count["B"] == rounds * ticks
