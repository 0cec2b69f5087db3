"""How a pair is evaluated, and what cannot be meant.

The range of a number stands once, in its type: settings made in Python are held to it here, and a file of settings
by whoever reads it.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cache
from math import isfinite
from operator import ge, gt, le, lt
from typing import Annotated, Any, get_args, get_type_hints

from annotated_types import Interval

from piv.errors import PairError

SMALLEST_WINDOW_PX = 8
Overlap = Annotated[float, Interval(ge=0.0, lt=1.0)]
WindowSigma = Annotated[float, Interval(ge=0.15, le=2.0)]
MinValid = Annotated[float, Interval(gt=0.0, le=1.0)]
NotNegative = Annotated[float, Interval(ge=0.0)]
AboveZero = Annotated[float, Interval(gt=0.0)]
ExtraPasses = Annotated[int, Interval(ge=0, le=20)]


@dataclass(frozen=True)
class PivSettings:
    """How to evaluate a pair.

    Parameters
    ----------
    windows_px : tuple of int
        Side of the square windows of each pass; the first one must hold about three times the largest
        displacement. It searches whole windows, all others look for what is left within a pixel.
    overlap : float
        Shared part of neighbouring windows, in every pass.
    window_sigma : float
        The windows' weights are exp(-x^2/(2 (s w)^2)) in each frame, w the side and s this number; 0 for windows
        without weights. A smaller one resolves more and is noisier.
    min_valid : float
        Smallest share of a window's weight on pixels valid in both deformed frames that makes a vector. The two
        masks move apart by the displacement, so near a mask edge this is less than the mask alone says.
    smoothing_px : float, optional
        Standard deviation of the predictor's smoothing between passes that refine; default a quarter of the last
        window.
    denoise : float
        Detail finer than the windows' resolution is kept where it is stronger than this many times the noise
        that correlation statistics expect there (`piv.correlation.denoise`); 0 keeps everything.
    extra_passes : int
        Most passes that are added at the end as long as vectors still move: strong gradients need more.
    outlier_threshold, outlier_epsilon_px : float
        Universal outlier detection: largest normalised residual, and usual noise.
    uncertainty : bool
        Give the random uncertainty of each vector.
    peak_ratios : bool
        Look for the second peak of every window; otherwise only where something speaks against a vector.

    Raises
    ------
    PairError
        A number that makes no sense.
    """

    windows_px: tuple[int, ...] = (64, 32, 32, 32)
    overlap: Overlap = 0.5
    window_sigma: WindowSigma = 0.3  # or 0
    min_valid: MinValid = 0.3
    smoothing_px: NotNegative | None = None
    denoise: NotNegative = 2.0
    extra_passes: ExtraPasses = 3
    outlier_threshold: AboveZero = 3.0
    outlier_epsilon_px: AboveZero = 0.1
    uncertainty: bool = True
    peak_ratios: bool = False

    def __post_init__(self) -> None:
        sides = self.windows_px
        if not sides or any(int(side) != side or side < SMALLEST_WINDOW_PX for side in sides):
            raise PairError(
                f"windows_px needs at least one window, of whole pixels and at least {SMALLEST_WINDOW_PX} px, "
                f"got {sides}"
            )
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, int | float) and not isfinite(value):
                raise PairError(f"{field.name} must be a finite number, got {value}")
            if value is not None and not (field.name == "window_sigma" and value == 0.0):
                _require(field.name, value)
        if self.extra_passes != int(self.extra_passes):
            raise PairError(f"extra_passes is a whole number, got {self.extra_passes}")


@cache
def _ranges() -> dict[str, Interval]:
    """Range of each setting that has one, as its type says."""
    found: dict[str, Interval] = {}
    for name, kind in get_type_hints(PivSettings, include_extras=True).items():
        for one in (kind, *get_args(kind)):  # a | None holds the type that is meant
            for about in getattr(one, "__metadata__", ()):
                if isinstance(about, Interval):
                    found[name] = about
    return found


def _require(name: str, value: Any) -> None:  # noqa: ANN401 - a number, where there is a range
    """Refuse a number out of its range."""
    if (within := _ranges().get(name)) is None:
        return
    rules: tuple[tuple[str, Any, Callable[[Any, Any], bool]], ...] = (
        ("above", within.gt, gt), ("at least", within.ge, ge), ("below", within.lt, lt),
        ("at most", within.le, le),
    )  # fmt: skip
    rules = tuple(rule for rule in rules if rule[1] is not None)
    if not all(holds(value, limit) for _, limit, holds in rules):
        said = " and ".join(f"{words} {limit:g}" for words, limit, _ in rules)
        raise PairError(f"{name} should be {said}, got {value}")
