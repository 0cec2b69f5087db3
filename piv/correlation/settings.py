"""How a pair is evaluated, and what cannot be meant."""

from dataclasses import dataclass, fields
from math import isfinite

from piv.errors import PairError

SMALLEST_WINDOW_PX = 8


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
    overlap: float = 0.5
    window_sigma: float = 0.3
    min_valid: float = 0.3
    smoothing_px: float | None = None
    denoise: float = 2.0
    extra_passes: int = 3
    outlier_threshold: float = 3.0
    outlier_epsilon_px: float = 0.1
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
        self._ask("overlap", "lies in 0 <= overlap < 1", 0.0 <= self.overlap < 1.0)
        self._ask("min_valid", "lies in 0 < min_valid <= 1", 0.0 < self.min_valid <= 1.0)
        self._ask("window_sigma", "is 0 or at least 0.15", self.window_sigma == 0.0 or self.window_sigma >= 0.15)
        self._ask("smoothing_px", "is not negative", self.smoothing_px is None or self.smoothing_px >= 0.0)
        self._ask("denoise", "is not negative", self.denoise >= 0.0)
        self._ask("extra_passes", "is a whole number from 0", self.extra_passes == int(self.extra_passes) >= 0)
        self._ask("outlier_threshold", "is positive", self.outlier_threshold > 0.0)
        self._ask("outlier_epsilon_px", "is positive", self.outlier_epsilon_px > 0.0)

    def _ask(self, name: str, rule: str, is_kept: bool) -> None:
        if not is_kept:
            raise PairError(f"{name} {rule}, got {getattr(self, name)}")
