"""Settings of one open camera, and its answers about itself while it is armed; the same for every backend."""

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass, field

from daq.cameras.camera import CameraBase, Setting
from daq.cameras.ids import CameraClock
from daq.cameras.sfnc import (
    Nodes,
    apply_settings,
    count_missed_triggers,
    enable_chunks,
    exposure_us,
    read_known,
    verify_settings,
)
from daq.errors import CameraError, CameraLost


@dataclass(slots=True)
class CameraFeatures:
    """Settings since the camera was opened, and what `begin` found when it was armed."""

    chunks: tuple[str, ...] = ()
    exposure_us: float = math.nan
    counts_triggers: bool = False
    _configured: dict[str, Setting] = field(default_factory=dict)
    _ignored_before: int = 0
    _clock: CameraClock | None = None

    def configure(
        self, nodes: Nodes, settings: Mapping[str, Setting], chunks: Sequence[str]
    ) -> dict[str, Setting]:
        """Set features in a safe order, and chunks; return what the camera reads back."""
        readback = apply_settings(nodes, settings)
        self._configured.update(readback)
        self._configured.update(enable_chunks(nodes, chunks))
        self.chunks = tuple(chunks)
        return readback

    def verify(self, nodes: Nodes) -> None:
        """Read the configured settings back once more; SettingsChanged if the camera lost any."""
        verify_settings(nodes, self._configured)

    def begin(self, nodes: Nodes) -> None:
        """Let the camera count the triggers it ignores from now on, and note its exposure time."""
        self.counts_triggers = count_missed_triggers(nodes, self._configured)
        self._ignored_before = int(nodes.get("CounterValue")) if self.counts_triggers else 0
        self.exposure_us = exposure_us(nodes)

    def count_ignored(self, nodes: Nodes) -> int | None:
        """Count the triggers that were ignored since `begin`; None if the camera does not count them."""
        if not self.counts_triggers:
            return None
        return max(0, int(nodes.get("CounterValue")) - self._ignored_before)

    def clock_ns(self, nodes: Nodes) -> int | None:
        """Read the camera's own clock; None if it cannot be read."""
        if self._clock is None:
            self._clock = CameraClock(nodes)
        return self._clock.read_ns(nodes)


class NodesCamera(CameraBase):
    """Base of cameras whose nodes are read in this process."""

    hidden: tuple[
        type[Exception], ...
    ] = ()  # what reading a feature raises that has no value in the present state

    def __init__(self) -> None:
        self._features = CameraFeatures()

    @abstractmethod
    def _open_nodes(self) -> Nodes:
        """Nodes of the open camera; CameraUsageError if it is closed."""

    def _errors(self, what: str) -> AbstractContextManager[None]:
        """Turn what the library reports into errors of ours."""
        return nullcontext()

    def configure(self, settings: Mapping[str, Setting], chunks: Sequence[str] = ()) -> dict[str, Setting]:
        """Set SFNC features in a safe order; returns what the camera reads back.

        CameraUsageError if it is armed.
        """
        nodes = self._open_nodes()
        self._require_disarmed()
        with self._errors("configure"):
            return self._features.configure(nodes, settings, chunks)

    def verify(self) -> None:
        """Read the configured settings back once more; SettingsChanged if the camera lost any."""
        nodes = self._open_nodes()
        with self._errors("verify"):
            self._features.verify(nodes)

    def settings(self) -> dict[str, Setting]:
        """Every readable feature with its value."""
        return read_all(self._open_nodes(), self.hidden)

    def read(self, names: Sequence[str]) -> dict[str, Setting]:
        """Values of a few features; those that the camera has not are left out."""
        nodes = self._open_nodes()
        with self._errors("read"):
            return read_known(nodes, names)

    def clock_ns(self) -> int | None:
        """The camera's own clock now; None if it cannot be read."""
        nodes = self._open_nodes()
        with self._errors("clock"):
            return self._features.clock_ns(nodes)

    def trigger(self) -> int | None:
        """Send one software trigger; returns the camera's clock right before."""
        self._require_armed()
        before_ns: int | None = None
        try:
            before_ns = self.clock_ns()
        except CameraLost:
            raise
        except CameraError:  # a clock that cannot be read is none
            pass
        with self._errors("trigger"):
            self._open_nodes().execute("TriggerSoftware")
        return before_ns


def read_all(nodes: Nodes, hidden: tuple[type[Exception], ...]) -> dict[str, Setting]:
    """Return every feature that has a value and can be read in the present state."""
    values = {}
    for name in nodes.names():
        with suppress(*hidden):
            if nodes.has(name):
                values[name] = nodes.get(name)
    return values
