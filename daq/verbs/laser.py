"""`rtpiv laser`: switch a laser off from anywhere, see whether it is, or align with weak pulses.

`off` first writes the bytes that switch off, past any program that holds the port, as the watchdog does; then it
opens the box, if nobody holds it, and reads back. `state` opens it too, and opening switches off what runs: nobody
who watches it would be there.
"""

from pathlib import Path

from daq.acquisition.bench.bench_file import load_bench
from daq.acquisition.bench.bench_table import Bench
from daq.acquisition.bench.opened import open_bench
from daq.errors import RunUsageError
from daq.terminal import console, error_console
from daq.timing.drivers import driver_class
from daq.timing.errors import LaserDoubt
from daq.timing.laser import Laser
from daq.timing.states import LaserState
from daq.timing.timing_table import TimingTable
from daq.verbs.paths import Named
from stages.errors import PortUnavailable
from stages.watchdog import stop, word_of

KIND = "timing"


def laser(
    action: str = "state",
    bench: Named = "bench.yaml",
    simulate: bool = False,
    name: str | None = None,
    rate_hz: float = 5.0,
    for_s: float = 5.0,
) -> LaserState:
    """Switch a laser off, look at it, or let weak pulses leave.

    Parameters
    ----------
    action : {"off", "state", "align"}
        What to do.
    bench : path
        bench.yaml.
    simulate : bool
        Use its simulation.
    name : str, optional
        Which device of kind `timing`, if there are several.
    rate_hz, for_s : float
        Of `align`, within the limits of the bench file.

    Returns
    -------
    LaserState
        What it is in the end.

    Raises
    ------
    RunUsageError
        The bench has no such device.
    LaserDoubt
        Off was said, and nobody has confirmed it.
    PortUnavailable
        There is no port to say it to.
    """
    loaded = load_bench(bench)
    device, section = _device(loaded, name)
    if action == "off" and not simulate:
        _say_off(section)
    try:
        with open_bench(loaded, simulate, only={device}) as hardware:
            opened = hardware.devices[device]
            assert isinstance(opened, Laser)
            if action == "align":
                _align(opened, rate_hz, for_s)
            console().print(f"{device}: {opened.state.value} ({opened.box.identity})")
            if opened.state is LaserState.UNKNOWN:
                raise LaserDoubt(f"{device} does not say that it is off; use its key and its STOP")
            return opened.state
    except PortUnavailable as busy:
        if action == "off":
            raise LaserDoubt(f"off was said to {device}, and could not be read back: {busy}") from busy
        raise


def _device(bench: Bench, name: str | None) -> tuple[str, TimingTable]:
    found = {key: device.section for key, device in bench.more.items() if device.kind == KIND}
    if name is None and len(found) != 1:
        known = ", ".join(found) or "none"
        raise RunUsageError(f"{bench.path}: say which device of kind {KIND}; there is {known}")
    section = found.get(name or next(iter(found)))
    if not isinstance(section, TimingTable):
        raise RunUsageError(
            f"{bench.path}: no device {name!r} of kind {KIND}; there is {', '.join(found) or 'none'}"
        )
    return name or next(iter(found)), section


def _say_off(section: TimingTable) -> None:
    """Say it several times without asking whose port it is; PortUnavailable if there is none."""
    if "://" not in section.port and not Path(section.port).exists():
        raise PortUnavailable(f"{section.port} does not exist, so off could not be said; use the laser's own key")
    box = driver_class(section.box)("laser", section.wiring)
    box.address = section.identity or ""
    stop(word_of("laser", section.port, section.baud or box.default_baud, False, box.off_bytes()))


def _align(opened: Laser, rate_hz: float, for_s: float) -> None:
    if opened.rules.align is None:
        opened.align("", rate_hz, for_s)  # says so, before anybody types anything
    error_console().print(
        f"{rate_hz:g} weak pulses a second for {for_s:g} s. Goggles on, door shut? Software is no interlock.\n"
        f"Type {opened.challenge} to let them leave: ",
        end="",
    )
    try:
        word = input()
    except EOFError:
        word = ""
    opened.align(word, rate_hz, for_s)
    error_console().print("light; Ctrl-C switches off")
    opened.wait()
