"""Errors of the stages; the name says whose fault it is.

    StageError
    +-- StageUsageError      the caller (also a ValueError); nothing was sent, nothing moved
    |   +-- OutOfRange           target not finite, or outside the limits of its axis
    |   +-- NotReferenced        absolute move or position asked of an axis that has to be homed first
    |   +-- Obstructed           the swept path comes closer to something than the clearance
    |   +-- MotionBarred         another device must not see motion now, such as a laser that is armed
    +-- PortError            the cable (also an OSError)
    |   +-- PortUnavailable      cannot be opened: missing, no permission, held by another process
    |   +-- DeviceLost           gone while open: unplugged or switched off; position unknown until homed
    |   +-- NoReply              nothing complete arrived before the deadline
    +-- DeviceError          the controller
        +-- ProtocolViolation    bytes that are no answer to what was asked; nothing is taken from them
        +-- WrongDevice          another device, model or set-up than the bench file describes
        +-- CommandRejected      the controller understood and refused; `code` is its own
        +-- LimitHit             a limit switch ended the motion; home the axis
        +-- AxisStalled          the motor did not follow; home the axis
        +-- MotionStopped        the motion was stopped; the position is the controller's
        +-- NotInPosition        the axis came to rest outside its tolerance, retries included

The command line prints these as one sentence and exits with code 3 (usage errors: 2).
"""

from ground.errors import DEVICE, USAGE, RtpivError


class StageError(RtpivError):
    """Root of everything the stages raise on purpose."""

    exit_code = DEVICE


class StageUsageError(StageError, ValueError):
    """A call that makes no sense now; nothing was sent and nothing moved."""

    exit_code = USAGE


class OutOfRange(StageUsageError):  # noqa: N818 - says what happened
    """A target is not a finite number or lies outside the limits of its axis."""


class NotReferenced(StageUsageError):  # noqa: N818
    """The axis has no position reference; home it first."""


class Obstructed(StageUsageError):  # noqa: N818
    """The way to the target comes closer to a body, target or camera than the clearance allows."""


class MotionBarred(StageUsageError):  # noqa: N818
    """Another device of the bench must not see motion now, such as a laser that is armed; the message says why."""


class PortError(StageError, OSError):
    """Root of what goes wrong between the computer and the controller."""


class PortUnavailable(PortError):  # noqa: N818
    """The port cannot be opened; the message says what to do."""


class DeviceLost(PortError):  # noqa: N818
    """The port died while it was open; positions are unknown until the axes are homed again."""


class NoReply(PortError):  # noqa: N818
    """No complete answer arrived in time."""


class DeviceError(StageError):
    """Root of what a controller does or says wrong."""


class ProtocolViolation(DeviceError):  # noqa: N818
    """The controller sent bytes that are no answer to the question; `raw` holds them."""

    def __init__(self, message: str, raw: bytes = b"") -> None:
        self.raw = raw
        shown = f" ({raw[:60]!r})" if raw else ""
        super().__init__(message + shown)


class WrongDevice(DeviceError):  # noqa: N818
    """Another device answers than the bench file describes."""


class CommandRejected(DeviceError):  # noqa: N818
    """The controller refused a command; `code` is its own word for why."""

    def __init__(self, message: str, code: str | int) -> None:
        self.code = code
        super().__init__(message)


class LimitHit(DeviceError):  # noqa: N818
    """A limit switch ended the motion; home the axis before moving it again."""


class AxisStalled(DeviceError):  # noqa: N818
    """The motor did not follow its command; clear the way, then home the axis."""


class MotionStopped(DeviceError):  # noqa: N818
    """The motion was stopped on request before it reached its target."""


class NotInPosition(DeviceError):  # noqa: N818
    """The axis rests further from its target than its tolerance although it was sent there again."""
