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
        +-- FrameError         the camera delivered something that cannot be the frame it announced

The command line prints these as one sentence and exits with code 3.
"""


class DaqError(Exception):
    """Root of everything the bench raises on purpose."""


class CameraError(DaqError):
    """Root of the camera part."""


class CameraUsageError(CameraError, ValueError):
    """A call that this camera cannot take in its present state; nothing was sent."""


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


class FrameError(CameraError):
    """A frame's size, format or layout contradicts its data; it is not used."""
