"""Errors of the bench; the name says whose fault it is.

    DaqError
    +-- CameraError
        +-- CameraUsageError   the caller: wrong order of calls (also a ValueError); nothing was sent
        |   +-- SettingRefused     a setting is unknown, out of range, or did not read back as asked
        +-- CameraSetupError   the machine: a library, producer or folder is missing or cannot be used
        +-- CameraBusy         another process holds the camera
        +-- SettingsChanged    the camera: it forgot settings (power dip, reset); configure it again
        +-- CameraTimeout      no frame came in time; the camera is alive
        +-- CameraLost         the cable or the camera: no answer; open it again
        +-- BadFrame           the camera delivered something that cannot be the frame it announced
            +-- FrameIncomplete    pixels of a frame were lost on the way; trigger again
            +-- OtherFormat        frames are not what the camera says it was set to; retaking does not help
    +-- BenchLacks         what a bench needs is not on this computer
    +-- RunError           what has to do with plans and runs
        +-- RunUsageError      the caller (also a ValueError); nothing has moved, nothing was written
        |   +-- PlanError          a plan that this bench cannot or must not carry out
        |   +-- ResumeRefused      a run that must not be continued with this plan, bench or scene
        |   +-- RunUnsuitable      no run, one that another process works on, or one without what is asked of it
        +-- DiskError          the disk: full, too slow, not writable; the run can be resumed
        |   +-- RunDamaged         what lies on the disk is not what a run wrote there; the message names it
        +-- FramesLost         frames were exposed and are gone; the message says where; the run can be resumed
        +-- BadBalance         the counts of a run contradict each other: a bug, or a camera that cannot count
        +-- FrameDoubt         a frame cannot be given to its trigger; what the run holds may be misfiled
        +-- RunInterrupted     ended on request; the run can be resumed
        +-- Unfinished         chunks of a campaign are not there; the same command goes on

The command line prints these as one sentence and exits with code 3 (RunUsageError: 2, RunInterrupted: 4).
"""

from collections.abc import Sequence

from ground.errors import DEVICE, INTERRUPTED, USAGE, RtpivError


class DaqError(RtpivError):
    """Root of everything the bench raises on purpose."""

    exit_code = DEVICE


class CameraError(DaqError):
    """Root of the camera part."""


class CameraUsageError(CameraError, ValueError):
    """A call that this camera cannot take in its present state; nothing was sent."""

    exit_code = USAGE


class SettingRefused(CameraUsageError):  # noqa: N818 - says what happened
    """The camera does not know a setting, or did not take its value."""


class CameraSetupError(CameraError):
    """A library, a GenTL producer or a folder is missing or unusable; the message says which."""


class CameraBusy(CameraError):  # noqa: N818
    """Another process controls the camera; close it there first."""


class SettingsChanged(CameraError):  # noqa: N818
    """The camera no longer has the settings it was given; configure it again, distrust frames since."""


class CameraTimeout(CameraError):  # noqa: N818
    """No frame arrived in time although the camera answers; look at the trigger."""


class CameraLost(CameraError):  # noqa: N818
    """The camera no longer answers; check cable and power, then open it again."""


class BadFrame(CameraError):  # noqa: N818
    """A frame's size, format or layout contradicts its data; it is not used."""


class FrameIncomplete(BadFrame):
    """Pixels of a frame were lost on the way; it is counted and not used."""


class OtherFormat(BadFrame):
    """The camera sends another pixel format or size than it reads back; the message names both."""


class BenchLacks(DaqError):  # noqa: N818 - says what is the matter
    """A port, library or file that a bench needs is not on this computer; the message names it.

    Parameters
    ----------
    said : str
        The message.
    findings : sequence of (str, bool or None, str)
        All that was looked at, as `rtpiv.verbs.doctor` returns it.
    """

    def __init__(self, said: str, findings: Sequence[tuple[str, bool | None, str]]) -> None:
        super().__init__(said)
        self.findings = tuple(findings)


class RunError(DaqError):
    """Root of the part about plans and runs."""


class RunUsageError(RunError, ValueError):
    """A request that makes no sense; nothing has moved and nothing was written."""

    exit_code = USAGE


class PlanError(RunUsageError):
    """The plan asks for what this bench cannot or must not do; the message says which step and why."""


class ResumeRefused(RunUsageError):  # noqa: N818
    """The run cannot be continued as asked: another plan, bench or scene, or nothing left to do."""


class RunUnsuitable(RunUsageError):  # noqa: N818 - says what it is
    """A folder is no run, belongs to another process, or does not hold what is asked of it."""


class DiskError(RunError):
    """The disk is full, too slow or not writable; make room, then resume the run."""


class RunDamaged(DiskError):  # noqa: N818
    """A frame or record of a run is not what was written; restore it from a copy, or take it again."""


class FramesLost(RunError):  # noqa: N818
    """Frames were exposed and are gone; what was written stays, and the run can be resumed."""


class BadBalance(RunError):  # noqa: N818
    """Triggered frames do not equal written + incomplete + rejected + lost."""


class FrameDoubt(RunError):  # noqa: N818
    """Nothing tells which trigger a frame belongs to; the run can be looked at, and not be resumed."""


class Unfinished(RunError):  # noqa: N818 - says what it is
    """Chunks of a campaign are missing, failed or being made; the same command goes on."""


class ReadingMissing(RunError):  # noqa: N818 - says what it is
    """A reading that the plan needs is silent."""


class RunInterrupted(RunError):  # noqa: N818
    """The run was ended on request before its last step; resume it when you like."""

    exit_code = INTERRUPTED
