"""Faults of the simulated camera, scheduled by frame number so that every test can repeat them.

Frames are numbered from power-up, 0 first, whether anybody receives them or not.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class FaultPlan:
    """What goes wrong, and when.

    Parameters
    ----------
    incomplete : tuple of int
        Frames that arrive with a part of their pixels missing.
    dropped : tuple of int
        Frames whose id is used up but which never leave the camera.
    skipped : tuple of int
        Exposures, counted from power-up, that are never made: no frame, no id.
    doubled : tuple of int
        Frames that are sent a second time, with an id of their own.
    first_skipped : int
        Most exposures that are skipped whenever the acquisition starts; how many is drawn anew each time.
    late_s : mapping of str to float
        Extra delay before a frame leaves [s], by frame number (a string, as JSON has it).
    lost_at : int, optional
        The camera stops answering when this frame is due.
    back_after_s : float, optional
        It answers again this long after it was lost [s], all settings reset; None: never.
    reset_at : int, optional
        Settings go back to their defaults when this frame is due, and nothing is said about it.
    restart_at : int, optional
        The camera restarts when this frame is due, and loses it: settings, clock and ids begin anew, and nothing
        is said about it.
    packet_loss : float
        Share of GigE stream packets that get lost on the way, 0 to 1.
    seed : int
        Seed of the packet loss, and of how many first exposures are skipped.
    """

    incomplete: tuple[int, ...] = ()
    dropped: tuple[int, ...] = ()
    skipped: tuple[int, ...] = ()
    doubled: tuple[int, ...] = ()
    first_skipped: int = 0
    late_s: Mapping[str, float] = field(default_factory=dict)
    lost_at: int | None = None
    back_after_s: float | None = None
    reset_at: int | None = None
    restart_at: int | None = None
    packet_loss: float = 0.0
    seed: int = 0
