"""A bench that stays open in a person's hands: the verbs of `rtpiv bench stage`, as calls that return values.

    with open_session("bench.yaml") as bench:
        bench.home()
        bench.move(glass_y=-20.0)
        bench.jog(glass_x=+0.5)
        print(bench.where())

Controllers that forget their reference when their port is closed (isel, Grbl) stay referenced as long as it is
open. A stop holds: after Ctrl-C, or `stop`, nothing moves until `clear`.

`here` says that the bench stands now as its scene file says. From then on keep-out is judged by that, and `save`
writes it into the bench file, together with what the controllers say of themselves.
"""

import math
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Self, cast

from daq.bench.bench_edit import Place, Value, difference, edit_values, replace_file
from daq.bench.bench_file import load_bench
from daq.bench.bench_table import STAGES, Bench, CameraSection
from daq.bench.elements import CAMERA
from daq.bench.guards import guard_of
from daq.bench.kinds import kind_of
from daq.bench.opened import check_devices, keep_apart, open_bench, require_camera_libraries, require_positions
from daq.errors import RunUsageError
from daq.timing.laser import Laser
from stages.axis import Arrival

DECIMALS = 4  # of a position that a person reads or a file keeps: a tenth of a micrometre


class BenchSession:
    """An open stage with the bench file it belongs to; use `open_session`.

    Parameters
    ----------
    bench : Bench
        What the file says.
    simulate : bool
        Use its simulation.

    Raises
    ------
    StageError
        A controller is not there, or is another one; nothing has moved.
    """

    def __init__(self, bench: Bench, simulate: bool = False) -> None:
        self.bench = bench
        self.simulated = simulate
        self._stack = ExitStack()
        try:
            opened = self._stack.enter_context(open_bench(bench, simulate, only={STAGES}))
            self.stage, self.simulation, self.rendering_s = opened.stage, opened.simulation, opened.rendering_s
            self._opened, self._devices = opened, dict(opened.devices)
        except BaseException:
            self._stack.close()
            raise

    @property
    def held(self) -> bool:
        """True if a stop holds the bench; see `clear`."""
        return self.stage.is_held

    def where(self) -> dict[str, float | None]:
        """Position of every axis at rest [mm]; None where it is not known."""
        return self.stage.where_mm()

    def home(
        self,
        *axes: str,
        tell: Callable[[str], None] | None = None,
        ask: Callable[[str], float] | None = None,
    ) -> dict[str, float | None]:
        """Home some axes, or all of them, in the configured order; return where every axis is then.

        Parameters
        ----------
        axes : str
            Their names; all axes if none, followed by the moves of `after_home`.
        tell : callable, optional
            Called with the name of an axis before it begins.
        ask : callable, optional
            Returns where an axis stands that is homed by hand [mm], as a person reads it; see `confirm`.

        Raises
        ------
        StageError
            A reference was not found, or a move of `after_home` must not be made.
        """
        self.stage.home(axes or None, tell, ask)
        return self.where()

    def confirm(self, **at_mm: float) -> None:
        """Say where axes rest that are homed by hand [mm], as read on their scales; nothing moves.

        Raises
        ------
        StageUsageError
            One moves, is said to be outside its limits, or homes by itself.
        """
        _require_numbers(at_mm)
        for name, mm in at_mm.items():
            self.stage.confirm(name, mm)

    def move(self, **targets_mm: float) -> dict[str, Arrival]:
        """Move axes to positions [mm], one after the other; return how each arrived.

        Raises
        ------
        StageUsageError
            Out of limits, obstructed, or not homed; nothing has moved.
        RunUsageError
            No axis is named, or a position is no finite number.
        MotionStopped
            A stop holds the bench, or came while it moved.
        """
        _require_numbers(targets_mm)
        return self.stage.move(targets_mm)

    def jog(self, **by_mm: float) -> dict[str, Arrival]:
        """Move axes by distances [mm] from where they are; otherwise as `move`."""
        _require_numbers(by_mm)
        return self.stage.move({name: self.stage.axis(name).position_mm + mm for name, mm in by_mm.items()})

    def stop(self) -> None:
        """Stop everything now and hold it until `clear`; from any thread."""
        self.stage.stop()

    def clear(self) -> None:
        """Let the bench move again after a stop: you have looked at it."""
        self.stage.clear_stop()

    def connect(self, *controllers: str) -> list[str]:
        """Open controllers again that were lost (all that are, if none is named); return which. Home them then.

        Raises
        ------
        RunUsageError
            There is no controller of that name; the message lists those there are.
        StageError
            One is still not there, or is another than the bench file says.
        """
        unknown = set(controllers) - set(self.stage.controllers)
        if unknown:
            known = ", ".join(self.stage.controllers)
            raise RunUsageError(f"there is no controller {', '.join(sorted(unknown))}; there are {known}")
        lost = controllers or [name for name, box in self.stage.controllers.items() if box.is_lost]
        for name in lost:
            self.stage.connect(name)
        return list(lost)

    def here(self, *axes: str) -> dict[str, float]:
        """Say that the bench stands now as the scene file says; return the positions [mm].

        Parameters
        ----------
        axes : str
            Of which axes that is true; all if none.

        Raises
        ------
        PlanError
            Some of these axes do not know where they are.
        """
        names = axes or tuple(self.stage.axes)
        where_mm = require_positions({name: self.stage.where_mm()[self.stage.axis(name).name] for name in names})
        scene_at_mm = {name: round(mm, DECIMALS) + 0.0 for name, mm in where_mm.items()}
        table = self.bench.table.model_copy(
            update={"scene_at_mm": {**self.bench.table.scene_at_mm, **scene_at_mm}}
        )
        self.bench = replace(self.bench, table=table)
        self.stage.guard = guard_of(self.bench)
        return scene_at_mm

    def changes(self) -> str:
        """Return what `save` would change in the bench file, as a difference to read; empty if nothing.

        Raises
        ------
        ConfigError, RunUsageError
            The file is wrong by now, or laid out in a way that cannot be edited.
        """
        return difference(self.bench.path, *self._texts())

    def save(self) -> Path | None:
        """Write `scene_at_mm`, and what the controllers say of themselves, into the bench file.

        Comments, order and layout stay.

        Returns
        -------
        Path or None
            Where the old file is kept; None if there was nothing to write.

        Raises
        ------
        ConfigError, RunUsageError, DiskError
            The file cannot be edited or written; it is untouched.
        """
        before, after = self._texts()
        return replace_file(self.bench.path, after) if before != after else None

    def device(self, name: str) -> object:
        """Another device of the bench, as its kind gives it; opened when it is first asked for.

        Parameters
        ----------
        name : str
            `camera`, or a name under `devices`.

        Raises
        ------
        RunUsageError
            There is none of that name; the message lists those there are.
        CameraError, TimingError
            It is not there, or its libraries are not installed.
        """
        known = self.bench.devices
        if name not in known:
            raise RunUsageError(f"there is no device {name!r} on this bench; there are {', '.join(known)}")
        if name not in self._devices:
            check_devices(self.bench, {name})
            require_camera_libraries(self.bench, self.simulated, {name})
            section, clock = self._opened.sections[name], self._opened.clock
            opening = kind_of(known[name].kind).open(section, self.bench, clock)
            self._devices[name] = device = self._stack.enter_context(opening)
            if isinstance(device, Laser):
                keep_apart(device, self.stage)
        return self._devices[name]

    def camera_section(self, name: str = CAMERA) -> CameraSection:
        """Section of the bench file for a camera of this session."""
        return cast("CameraSection", self._opened.sections[name])

    def close(self) -> None:
        """Stop what moves and close everything; harmless when repeated."""
        self._stack.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def _texts(self) -> tuple[str, str]:
        """Text of the bench file as it is, and with what is known now."""
        values: dict[Place, Value] = {
            ("scene_at_mm", name): mm for name, mm in self.bench.table.scene_at_mm.items()
        }
        if not self.simulated:  # simulated boxes say something else than yours
            for name, controller in self.stage.controllers.items():
                said, wanted = controller.identity, self.stage.config.controllers[name].identity
                if said and not (wanted and wanted in said):
                    values["stages", "controllers", name, "identity"] = said
        return edit_values(self.bench.path, values, after={"scene_at_mm": "scene"})


def open_session(bench: Path | str, simulate: bool = False, home: bool = False) -> BenchSession:
    """Open the stage of a bench and keep it open.

    Parameters
    ----------
    bench : Path
        bench.yaml.
    simulate : bool
        Use its simulation.
    home : bool
        Home every axis first, in the configured order.

    Returns
    -------
    BenchSession
        To be used in a ``with`` block, or closed by `close`.

    Raises
    ------
    ConfigError, StageError
        The file is wrong, or a controller is not there.
    """
    session = BenchSession(load_bench(bench), simulate)
    try:
        if home:
            session.home()
    except BaseException:
        session.close()
        raise
    return session


def _require_numbers(named: Mapping[str, float]) -> None:
    if not named:
        raise RunUsageError("give at least one axis=mm")
    for name, mm in named.items():
        if not math.isfinite(mm):
            raise RunUsageError(f"{name}={mm}: use axis=mm, as in target_x=1.5")
