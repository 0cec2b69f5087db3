"""Settings of one open camera, and its answers about itself while it is armed; the same for every backend."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from daq.cameras.camera import Setting
from daq.cameras.ids import CameraClock
from daq.cameras.sfnc import (
    Nodes,
    apply_settings,
    count_missed_triggers,
    enable_chunks,
    exposure_us,
    verify_settings,
)


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
