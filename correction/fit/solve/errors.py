"""Why a scene could not be fitted.

CorrectionError
+-- FitError
    +-- ViewsMissing    the frames given cannot determine the scene
    +-- GlassNotSeen    the frames show no glass, or glass that is not where the scene says
    +-- FitFailed       a fit was found and is not good enough to be used; gate, value and limit are kept
"""

from correction.errors import CorrectionError


class FitError(CorrectionError):
    """Root of what a scene fit raises on purpose."""


class ViewsMissing(FitError):  # noqa: N818 - says what is wrong
    """More or other frames are needed; the message says which."""


class GlassNotSeen(FitError):  # noqa: N818
    """The frames do not show the spheres of the scene."""


class FitFailed(FitError):  # noqa: N818
    """The best fit misses a gate.

    Parameters
    ----------
    gate : str
        Name of the gate.
    value, limit : float
        What was reached, and what is needed.
    reason : str
        A sentence with the cure.
    """

    def __init__(self, gate: str, value: float, limit: float, reason: str) -> None:
        self.gate, self.value, self.limit, self.reason = gate, value, limit, reason
        super().__init__(f"the fit failed at gate {gate!r} ({value:.3g}, limit {limit:.3g}): {reason}")
