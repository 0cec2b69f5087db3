"""Anything with ``set``, ``stop`` and ``position``: what Bluesky's world calls a positioner, without importing it.

EPICS motors, Tango and yaq axes and many laboratories' own come as such objects (ophyd). ``set`` returns a
status with ``done`` and ``exception``; `moving`, `home` and `disconnect` are used where they are there. Each
object is made, read and commanded in the thread of its controller alone. Objects whose ``set`` needs a running
event loop (ophyd-async) cannot be driven this way.
"""

import contextlib
from typing import Any

from ground.named_program import import_program
from stages.controller_tables import ForeignTable, PositionersTable
from stages.errors import DeviceError, PortUnavailable, StageUsageError, WrongDevice
from stages.foreign.foreign_controller import ForeignController

NEEDED = ("set", "stop", "position")


class Positioners(ForeignController):
    """Some objects of one library."""

    library = "objects of others"

    _objects: dict[str, Any]
    _mm_per_unit: dict[str, float]
    _status: dict[str, Any]

    def _load(self, table: ForeignTable) -> str:
        assert isinstance(table, PositionersTable)
        self._objects, self._mm_per_unit, self._status = {}, {}, {}
        said = []
        for channel in self._channels:
            about = table.objects[channel]
            made = _make(about.object, dict(about.arguments))
            if missing := [name for name in NEEDED if not hasattr(made, name)]:
                raise WrongDevice(f"{self.name}: {about.object} has no {' and no '.join(missing)}")
            self._objects[channel], self._mm_per_unit[channel] = made, about.mm_per_unit
            said.append(
                f"{channel}: {about.object} {getattr(made, 'prefix', '') or getattr(made, 'name', '')}".strip()
            )
        return ", ".join(said)

    def _unload(self) -> None:
        for made in self._objects.values():
            for name in ("disconnect", "close"):
                with contextlib.suppress(Exception):
                    getattr(made, name, lambda: None)()

    def _busy(self, channel: str) -> bool:
        made, status = self._objects[channel], self._status.get(channel)
        if status is not None and status.done:
            error, self._status[channel] = _failure(status), None
            if error is not None and not self._stopped:
                raise DeviceError(f"{self.name} channel {channel}: {error}") from error
            status = None
        return status is not None or bool(getattr(made, "moving", False))

    def _read_mm(self, channel: str) -> float:
        return float(self._objects[channel].position) * self._mm_per_unit[channel]

    def _send(self, channel: str, target_mm: float) -> None:
        self._status[channel] = self._objects[channel].set(target_mm / self._mm_per_unit[channel])

    def _seek(self, channel: str) -> None:
        home = getattr(self._objects[channel], "home", None)
        if home is None:
            raise StageUsageError(f"{self.name} channel {channel} has no home(); set homing: hand")
        self._status[channel] = home()

    def _halt(self) -> str:
        said = []
        for channel, made in self._objects.items():
            try:
                made.stop()
            except Exception as error:  # whatever one says, the others are stopped
                said.append(f"{channel}: {error}")
        return "; ".join(said)


def _failure(status: Any) -> BaseException | None:  # noqa: ANN401 - third-party
    """Return why a status has failed; None if it has not."""
    error = status.exception()
    if error is None and not getattr(status, "success", True):
        return DeviceError("it has not arrived, and says no more")
    found: BaseException | None = error
    return found


def _make(dotted: str, arguments: dict[str, Any]) -> Any:  # noqa: ANN401
    try:
        made = import_program(dotted)
    except (ImportError, AttributeError) as error:
        raise PortUnavailable(f"{dotted} cannot be imported: {error}") from error
    return made(**arguments)
