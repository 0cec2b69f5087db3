"""Gauges of the lab at every step of a run: read, shown, and said once when one falls silent."""

from collections.abc import Collection, Mapping
from typing import Any

from daq.bench.reading import Gauge, Reading
from daq.errors import ReadingMissing
from daq.runner.progress import Progress


class Gauges:
    """Readings of an open bench.

    Parameters
    ----------
    devices : mapping
        Every device that is open, by name; those that can be read are taken.
    needed : collection of str
        Names of those without which no step is taken.
    """

    def __init__(self, devices: Mapping[str, object], needed: Collection[str] = ()) -> None:
        self._gauges: dict[str, Gauge] = {
            name: device for name, device in devices.items() if isinstance(device, Gauge)
        }
        self._needed = frozenset(needed)
        self._silent: set[str] = set()

    def read(self, progress: Progress) -> dict[str, dict[str, Any]]:
        """Read all of them, for a line of the journal.

        Raises
        ------
        ReadingMissing
            One that is needed shows nothing.
        """
        found = {name: gauge.reading() for name, gauge in self._gauges.items()}
        for name, reading in found.items():
            progress.readings[name] = "-" if reading.missing else f"{reading.value:g} {reading.unit}"
            self._judge(name, reading, progress)
        return {name: reading.to_dict() for name, reading in found.items()}

    def _judge(self, name: str, reading: Reading, progress: Progress) -> None:
        if not reading.missing:
            self._silent.discard(name)
            return
        if name in self._needed:
            raise ReadingMissing(
                f"no reading of {name}, which the plan needs: {reading.missing}; see to it, then rtpiv resume"
            )
        if name not in self._silent:
            self._silent.add(name)
            progress.remarks.append(f"no reading of {name}: {reading.missing}; the run goes on without")
