"""What the vendors' manuals say about their boxes beyond what a polite one does."""

import pytest

from sim.emulators.line import Line
from stages.errors import AxisStalled, NoReply, NotReferenced
from stages.protocols.zaber_ascii import Alert, Info
from stages.states import AxisState


@pytest.mark.parametrize("flag", ["FR", "FO", "FV", "FC", "FM", "FH", "FX"])
def test_zaber_every_fault_flag_ends_the_motion_and_the_trust(bench, flag):
    """All flags that begin with F are faults; FX is none of today's, and a fault all the same."""
    made = bench("zaber_ascii").homed({"a": 20.0})
    axis = made.line.emulator.axis(1, 1)
    made.clock.at(made.clock.now_s() + 1.0, lambda: axis._end({"FS"}))
    real, emulator = axis.__class__.flag, made.line.emulator
    axis.__class__.flag = property(lambda box: flag if "FS" in box.flags else real.fget(box))
    try:
        with pytest.raises(AxisStalled, match=rf"\({flag}\); clear the way and home it"):
            made.stage.move({"a": 100.0})
        assert made.stage.axis("a").state is AxisState.UNREFERENCED
        with pytest.raises(NotReferenced):
            made.stage.move({"a": 50.0})
    finally:
        axis.__class__.flag = real
    assert emulator is made.line.emulator


@pytest.mark.parametrize("checksums", [True, False])
def test_zaber_alerts_and_information_between_answers_are_nobodys_answer(bench, monkeypatch, checksums):
    """`comm.alert` may be on, a knob may be turned, and any answer may be continued by # lines."""
    made = bench("zaber_ascii")
    made.line.emulator._checked = checksums
    send = Line.send

    def talkative(line, data):
        for said in (Alert(1, 1, False, "--", "", checksums), Info(1, 0, "turn the knob", None, checksums)):
            line.emulator.say(said.to_bytes())
        send(line, data)
        line.emulator.say(Alert(1, 2, True, "NC", "", checksums).to_bytes())

    monkeypatch.setattr(Line, "send", talkative)
    made.stage.home()
    for target_mm in (30.0, 29.0):
        made.stage.move({"a": target_mm, "b": target_mm + 40.0})
        assert made.stage.where_mm() == pytest.approx({"a": target_mm, "b": target_mm + 40.0}, abs=0.01)


@pytest.mark.parametrize(("boot_s", "wakes"), [(1.9, True), (30.0, False)])
def test_a_grbl_board_that_opening_has_reset_is_waited_for(bench, boot_s, wakes):
    """Boards with a boot loader reset when the port is opened, and hear nothing for two seconds."""
    made = bench("grbl")
    made.stage.close()
    made.line.emulator._boots_until_s = made.clock.now_s() + boot_s
    made.stage = made.stage.__class__(made.table, made.clock)
    made.opened.append(made.stage)
    begun_s = made.clock.now_s()
    if not wakes:
        with pytest.raises(NoReply, match="switched on"):
            made.stage.connect("box")
        assert made.clock.now_s() - begun_s < 20.0
        return
    made.stage.connect("box")
    made.stage.home()
    made.stage.move({"a": 40.0})
    assert made.stage.where_mm()["a"] == pytest.approx(40.0, abs=0.01)


def test_pi_an_answer_of_many_lines_is_one_answer(bench):
    """Controllers with six axes answer POS? of all of them; each line but the last ends with a space."""
    made = bench("pi_gcs2")
    box = made.controller
    answer = box._ask("POS?")
    assert set(answer.values()) == set(box._axes[None])  # alone on its port: no address
    assert len(answer.lines) > 1
