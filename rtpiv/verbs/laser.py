"""`rtpiv laser`: switch lasers off, show their state, align with weak pulses, test a timing unit.

`off` goes to every laser that a bench file of the lab or a running process names.  It first writes the bytes that
switch off, past any program that holds the port, as the watchdog does; then it opens the box, if it is free,
and reads back. `state` opens it too, and opening switches off what runs, as it would be unattended.
"""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Literal

from daq.bench.bench_file import load_bench
from daq.bench.elements import CAMERA
from daq.bench.known_lasers import KIND, KnownLaser, each_once, is_unreadable, lasers_near, lasers_of, open_lasers
from daq.bench.opened import OpenBench, open_bench
from daq.errors import RunUsageError
from daq.timing.errors import LaserDoubt
from daq.timing.laser import Laser
from daq.timing.states import LaserState
from daq.timing.switch_off import SwitchedOff, switch_off
from ground.terminal import console, error_console
from rtpiv.options.numbers import Positive
from rtpiv.verbs.paths import Named, path_of


def laser(
    action: Literal["off", "state", "align", "prove"] = "state",
    /,
    bench: Named | None = None,
    simulate: bool = False,
    name: str | None = None,
    rate_hz: Positive = 5.0,
    for_s: Positive = 5.0,
) -> LaserState:
    """Switch lasers off, show the state of one, fire weak pulses for alignment, or test a timing unit.

    Parameters
    ----------
    action : {"off", "state", "align", "prove"}
        What to do.
    bench : path, optional
        Bench file.  Default: those of this folder, or of the nearest parent folder with a laser.  `off` always
        reaches lasers that running processes have open, too, even if the file has none.
    simulate : bool
        Use the simulation of the bench.
    name : str, optional
        Device of kind `timing`; default for `off`: all.
    rate_hz : float
        Pulse rate of `align` and `prove`, within the limits of the bench file.
    for_s : float
        Duration of `align`, within the limits of the bench file.

    Returns
    -------
    LaserState
        State at the end.

    Raises
    ------
    RunUsageError
        There is no such device, or there are several and none is named.
    LaserDoubt
        A laser was not reached, or does not confirm that it is off; each is named.
    PortError
        There is no port.
    """
    file = path_of(bench)
    if action == "off" and not simulate:
        _switch_off(_find_lasers(file, name, anywhere=file is None or not lasers_of(file)))
        return LaserState.SAFE
    chosen = _only_laser(_find_lasers(file, name), file)
    assert chosen.bench is not None
    loaded, needed = load_bench(chosen.bench), {chosen.name}
    if action == "prove":
        needed |= {CAMERA, *(name for name, device in loaded.more.items() if device.kind == "counter")}
    with open_bench(loaded, simulate, only=needed) as hardware:
        opened = hardware.devices[chosen.name]
        assert isinstance(opened, Laser)
        if action == "align":
            _align(hardware, chosen.name, opened, rate_hz, for_s)
        elif action == "prove":
            from rtpiv.verbs.laser_prove import prove_box

            prove_box(hardware, chosen.name, opened, rate_hz)
        console().print(f"{chosen.name}: {opened.state.value} ({opened.box.identity})")
        console().print(f"switches: {opened.switches.objection() or opened.switches.sentence()}", soft_wrap=True)
        if opened.state is LaserState.UNKNOWN:
            raise LaserDoubt(f"{chosen.name} does not confirm that it is off; use its key and its STOP")
        return opened.state


def _find_lasers(file: Path | None, name: str | None, anywhere: bool = False) -> list[KnownLaser]:
    """Return the lasers of a file, with `anywhere` also those nearby and in use; RunUsageError without any."""
    folder = Path.cwd() if file is None else file.parent
    found = lasers_near(folder) if file is None or anywhere else lasers_of(file)
    found += open_lasers() if anywhere else []
    if file is not None and is_unreadable(file):
        found.insert(0, KnownLaser("laser", file, None))
    meant = [laser for laser in each_once(found) if name is None or laser.name == name]
    if meant:
        return meant
    where = f"the bench files of {folder} and above" if file is None or anywhere else str(file)
    there = ", ".join(map(str, found)) or "none"
    which = "laser" if name is None else f"device {name!r} of kind {KIND}"
    name_it = "Name a bench file with --bench" if file is None else "Name one that has it"
    raise RunUsageError(
        f"no {which}", place=where, cure=f"there is {there}. {name_it}, or use the laser's own key"
    )


def _only_laser(lasers: list[KnownLaser], file: Path | None) -> KnownLaser:
    """Return the only laser; RunUsageError if there are several."""
    if len(lasers) == 1:
        return lasers[0]
    how = "--name" if file is not None else "--name, or --bench"
    raise RunUsageError(f"choose a laser with {how}; there is {', '.join(map(str, lasers))}")


def _switch_off(lasers: list[KnownLaser]) -> None:
    """Say off to all at the same time, and what became of each; LaserDoubt if one may not be off."""
    with ThreadPoolExecutor(len(lasers)) as threads:
        outcomes = list(threads.map(_off, lasers))
    screen = console()
    for laser, outcome in zip(lasers, outcomes, strict=True):
        screen.print(f"{laser}: {outcome.words}", soft_wrap=True)
    if left := [laser.name for laser, outcome in zip(lasers, outcomes, strict=True) if not outcome.confirmed]:
        raise LaserDoubt(
            f"not confirmed to be off: {', '.join(left)}; use the key and the STOP of the laser itself"
        )


def _off(laser: KnownLaser) -> SwitchedOff:
    if laser.table is None:
        return SwitchedOff(
            False,
            "NOT reached, its bench file cannot be read, or has no box and port: use the laser's own key",
        )
    try:
        return switch_off(laser.table)
    except Exception as error:  # one that cannot be reached must not hide what became of the others
        return SwitchedOff(False, f"NOT reached ({error}): use the laser's own key")


def _align(hardware: OpenBench, name: str, opened: Laser, rate_hz: float, for_s: float) -> None:
    from daq.runner.laser_session import what_is_proven  # nothing that off does not need is in its way

    opened.low_energy_burst(rate_hz, for_s)  # limits are checked before goggles are put on
    error_console().print(
        f"{rate_hz:g} weak pulses a second for {for_s:g} s. Goggles on, door shut? Software is no interlock.\n"
        f"Switches: {opened.switches.sentence()}.\nThe box: {what_is_proven(hardware, name, opened)}.\n"
        f"Type {opened.challenge} to let them leave: ",
        end="",
        soft_wrap=True,
    )
    try:
        code = input()
    except EOFError:
        code = ""
    opened.align(code, rate_hz, for_s)
    error_console().print("light; Ctrl-C switches off")
    opened.wait()
