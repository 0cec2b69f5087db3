"""A program that ends by Ctrl-C or is killed, at any byte of a move or a reference run: nothing goes on moving."""

import pytest

from tests.slow_cases import slow
from tests.stages.killed import Killed, ToldWatchdog, places

WATCHDOG_S = (0.02, 0.05, 0.1, 0.22)  # after a kill, when it writes what stops
BRAKED_S = 1.0  # the last of these, and the ramp


class End:
    """Ends the program, once."""

    def __init__(self, made, how):
        self.made, self.how, self.ended_s = made, how, None
        made.controller.watchdog = self.watchdog = ToldWatchdog()

    def strike(self):
        made = self.made
        self.ended_s = made.clock.now_s()
        if self.how == "Ctrl-C":
            raise KeyboardInterrupt
        made.line.send = lambda data: None
        for after_s in WATCHDOG_S if self.watchdog.is_told else ():
            made.clock.at(self.ended_s + after_s, self.stop_as_the_watchdog_does)
        raise Killed

    def stop_as_the_watchdog_does(self):
        for data in self.made.controller.watchdog_bytes():
            self.made.line.emulator.feed(data)


def begun(bench, driver):
    return bench(driver).homed({"a": 20.0, "b": 22.0})


DOINGS = {"move": lambda stage: stage.move({"a": 45.0, "b": 42.0}), "home": lambda stage: stage.home()}


def play(bench, driver, doing, how, place, what):
    """Begin something, end the program at a place, and watch the carriages; whether it was ended."""
    made = begun(bench, driver)
    end = End(made, how)
    if what == "seconds":
        made.clock.at(made.clock.now_s() + place, end.strike)
    else:
        made.line.hooks.after(place, what, end.strike)
    try:
        with made.stage:
            DOINGS[doing](made.stage)
    except (KeyboardInterrupt, Killed):
        pass
    made.line.hooks.clear()
    if end.ended_s is None:
        return False
    made.clock.advance_to(end.ended_s + BRAKED_S)
    places_mm = [made.world.true_mm(axis) for axis in "ab"]
    made.clock.sleep_s(30.0)
    assert [made.world.true_mm(axis) for axis in "ab"] == places_mm
    assert made.world.witness.judge() == []
    return True


def play_all(bench, driver, doing, how, number):
    made, ended = begun(bench, driver), 0
    for place, what in places(made, lambda: DOINGS[doing](made.stage), number):
        try:
            ended += play(bench, driver, doing, how, place, what)
        except AssertionError as error:
            raise AssertionError(f"{driver}, {doing}, {how} after {place} {what}: {error}") from error
    return ended


@pytest.mark.parametrize("number", [2, slow(30)])
@pytest.mark.parametrize("how", [slow("Ctrl-C"), "kill"])
@pytest.mark.parametrize("doing", DOINGS)
def test_nothing_moves_on_when_a_program_has_ended(bench, driver, doing, how, number):
    assert play_all(bench, driver, doing, how, number) > 2 * number
