"""Settings of the evaluation of a pair, and their ranges.

Passes go down to the usual windows, the last of `windows_px`. Where a finest window is set, each place finds its
own from there (`piv.correlation.halving`): `finest_px` where halving shows more, and the usual ones elsewhere.

The range of a number stands once, in its type: settings made in Python are held to it here, and a file of settings
by its reader.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import cache
from math import isfinite
from operator import ge, gt, le, lt
from typing import Annotated, Any, get_args, get_type_hints

from annotated_types import Interval

from piv.correlation.windows import WindowGrid, grid_with_step
from piv.errors import PairError

SMALLEST_WINDOW_PX = 8
LEAST_SUPPORT = 0.1  # of a window's weight
ADD_UP = 0.5  # overlap from which on sums over windows add up to those over larger ones
Overlap = Annotated[float, Interval(ge=0.0, lt=1.0)]
WindowSigma = Annotated[float, Interval(ge=0.15, le=2.0)]
MinValid = Annotated[float, Interval(gt=0.0, le=1.0)]
NotNegative = Annotated[float, Interval(ge=0.0)]
AboveZero = Annotated[float, Interval(gt=0.0)]
ExtraPasses = Annotated[int, Interval(ge=0, le=20)]


@dataclass(frozen=True)
class PivSettings:
    """Settings of the evaluation of a pair.

    Parameters
    ----------
    windows_px : tuple of int
        Side of the square windows of each pass; the first one must hold about three times the largest
        displacement. It searches whole windows, all others look for what is left within a pixel.
    finest_px : int, optional
        Side of the smallest windows that a place may find for itself; default: all are the usual ones. `evaluate`
        and `mean` say 16 by default.
    overlap : float
        Shared part of neighbouring windows, in every pass; of the finest in the result.
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
    flow_beyond_mask : bool
        The mask hides a flow that goes on behind it, such as the rim of what a camera sees; otherwise it may be a
        wall at which the flow bends most, and vectors beside it are less certain.
    drop_uncertain : bool
        Reject vectors that are hardly known by their own uncertainty. False in a series, which averages them: they
        stand where the flow varies most, so statistics without them would miss part of the stresses.

    Raises
    ------
    PairError
        A number that makes no sense.
    """

    windows_px: tuple[int, ...] = (64, 32, 32, 32)
    finest_px: int | None = None
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
    flow_beyond_mask: bool = False
    drop_uncertain: bool = True

    def __post_init__(self) -> None:
        sides = self.windows_px
        if not sides or any(side % 1 != 0 or side < SMALLEST_WINDOW_PX for side in sides):
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
        if self.finest_px is not None and not (
            self.finest_px % 1 == 0 and SMALLEST_WINDOW_PX <= self.finest_px < sides[-1] < sum(sides)
        ):
            raise PairError(
                f"finest_px is a whole number of pixels, at least {SMALLEST_WINDOW_PX} and smaller than the last "
                f"of two windows or more, got {self.finest_px} below {sides}"
            )
        if self.extra_passes % 1 != 0:
            raise PairError(f"extra_passes is a whole number, got {self.extra_passes}")

    @property
    def finds_windows(self) -> bool:
        """True if each place finds its window."""
        return self.finest_px is not None

    @property
    def finest(self) -> int:
        """Side of the smallest windows there are."""
        return self.windows_px[-1] if self.finest_px is None else self.finest_px

    @property
    def support(self) -> float:
        """Share of a window's weight on valid pixels from which on passes follow it, with a vector or without.

        Where they end half a window before a mask, what continues their field errs by the wall's layer.
        """
        return min(LEAST_SUPPORT, self.min_valid)

    @property
    def windows_text(self) -> str:
        """Sides of the last windows in words."""
        usual = f"{self.windows_px[-1]} px"
        return f"{usual}, or {self.finest} px where they show more" if self.finds_windows else usual

    def own_grid(self, shape: tuple[int, int]) -> tuple[WindowGrid, int]:
        """Finest windows of a frame (H, W), close enough to add up to larger ones; and every how many'th is kept.

        The finest are a pixel larger than set if the usual ones have a middle pixel and they would have none, or
        the other way round.
        """
        usual = self.windows_px[-1]
        size = self.finest + (usual - self.finest) % 2
        step = max(1, round(size * (1.0 - self.overlap)))
        every = 1 if not self.finds_windows or self.overlap >= ADD_UP else 2
        return grid_with_step(shape, size, -(-step // every)), every

    def result_grid(self, shape: tuple[int, int]) -> WindowGrid:
        """Windows of usual size where the vectors of a frame (H, W) stand; those at its edge reach beyond it."""
        own, every = self.own_grid(shape)
        usual = self.windows_px[-1]
        row, column = (first[::every] - (usual - own.size_px) // 2 for first in (own.row, own.column))
        return WindowGrid(row, column, usual, every * own.step_px)


def settings_of(kept: Mapping[str, Any]) -> PivSettings:
    """Settings from what a file has kept of them.

    Raises
    ------
    PairError, TypeError
        A number that makes no sense, or a name that is none.
    """
    given: Any = {name: tuple(value) if isinstance(value, list) else value for name, value in kept.items()}
    return PivSettings(**given)


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


FOUND_WINDOWS = PivSettings(finest_px=16)  # the default of an evaluation: each place finds its windows
