"""Errors of timing units and lasers.

TimingError
+-- TimingUsageError   the caller (also a ValueError); nothing was sent, nothing fired; exit code 2
|   +-- PulsesRefused      dt, rate or exposures that do not go together
|   +-- NotNow             the state of the laser does not allow it; the message says what does
|   +-- NotArmed           a condition is not met, or the code that was typed is not the one shown
+-- LaserStopped       switched off: on request, or because a condition was lost; `safe()` goes on from there
+-- LaserDoubt         an answer contradicts the settings; it was switched off
    +-- WrongBox           another box, or a set-up of it that must not be used
"""

from daq.errors import DaqError, RunUsageError


class TimingError(DaqError):
    """Root of everything a timing unit or laser raises on purpose; the line's own errors are `stages.errors`."""


class TimingUsageError(TimingError, RunUsageError):
    """A request that makes no sense; nothing was sent and nothing fired."""


class PulsesRefused(TimingUsageError):  # noqa: N818 - says what happened
    """dt, rate, delays and exposures do not go together; the message says which limit is broken."""


class NotNow(TimingUsageError):  # noqa: N818
    """The laser is in a state that does not allow this; the message says the way."""


class NotArmed(TimingUsageError):  # noqa: N818
    """A condition for light is not met, or not confirmed; the message names it."""


class LaserStopped(TimingError):  # noqa: N818
    """The laser was switched off, on request or because a condition was lost; look at it, then `safe()`."""


class LaserDoubt(TimingError):  # noqa: N818
    """The unit's answer contradicts its settings; it was switched off, and `safe()` has to confirm that."""


class WrongBox(LaserDoubt):
    """Another box answers than the bench file describes, or one that is set up to act by itself."""
