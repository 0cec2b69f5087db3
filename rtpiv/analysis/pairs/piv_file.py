"""Settings of the evaluation of pairs: one declaration for the YAML file, the command line and Python.

    final_window_px: 16
    overlap: 0.75
    window: gaussian
    prepare: [sliding-minimum, min-max]

Windows are named by the first, the last, and how many passes there are: the side is halved from pass to pass
until it is the last one's, which then repeats.  Where no last side is named, each place finds its own
(`piv.correlation.halving`).  `prepare` names what is done to frames, in order (see
`piv.preprocessing.preparation`); left out, each kind of run has its own.

`sigma_w_m_s` and `w_over_u` change no vector: they describe the out-of-plane motion, which oblique viewing shows
as in-plane displacement, and with it the uncertainty of vectors and mean (`piv.statistics.out_of_plane`).
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypedDict, Unpack, get_type_hints

from annotated_types import Interval
from pydantic import create_model

from ground.config import Document, Table, load_yaml, validate
from ground.errors import ConfigError, Problem
from piv.correlation.settings import (
    FOUND_WINDOWS,
    SMALLEST_WINDOW_PX,
    AboveZero,
    ExtraPasses,
    MinValid,
    NotNegative,
    Overlap,
    PivSettings,
    WindowSigma,
)
from piv.errors import PairError
from piv.preprocessing.preparation import Preparation
from piv.statistics.out_of_plane import NOTHING_TOLD, OutOfPlane
from rtpiv.options.numbers import steps

Window = Literal["gaussian", "square"]
Side = Annotated[int, Interval(ge=SMALLEST_WINDOW_PX, le=1024)]
FINAL_PX, FINEST_PX = (
    FOUND_WINDOWS.windows_px[-1],
    FOUND_WINDOWS.finest_px,
)  # sides of the windows that places find by default
LEAST_VALID = 0.15  # share of windows; of unlike frames 0.02 to 0.1 are valid
LARGEST_FIRST = 2  # times the last window at least: a first window as small as that finds next to nothing


class PivOptions(TypedDict, total=False):
    """Settings of the correlation; an option overrides the file.

    Keys of the file, options of the command line and keywords of the verbs are the same; defaults are those of
    `piv.correlation.settings.PivSettings`.

    Parameters
    ----------
    piv : path
        YAML file with any of these settings (docs/files.md).
    first_window_px : int
        Side of the windows of the first pass, at least three times the largest displacement (default 64);
        enlarged automatically if few vectors are valid.
    final_window_px : int
        Side of the windows of the last pass.  If given alone, all windows have this side.  Smaller windows resolve
        shorter waves and are noisier (default: 32, or 16 where these resolve more).
    finest_window_px : int
        Side of the smallest windows, used where they resolve more; it sets the spacing of the vectors (default 16;
        none if the side of the last pass is given).
    passes : int
        Number of passes (default 4 or more): the side is halved from pass to pass, and the last one is repeated.
        With 1 all windows have one side.
    overlap : float
        Overlap of neighbouring windows, of the finest ones if sizes vary (default 0.5).
    window : {"gaussian", "square"}
        Weighting of the pixels in a window (default gaussian).
    window_sigma : float
        Standard deviation of the Gaussian weighting in each frame, in sides (default 0.3).
    min_valid : float
        Smallest share of a window's weight on valid pixels (default 0.3).
    least_valid : float
        Smallest accepted share of valid vectors, median of the pairs of a series; a smaller share is an error,
        since in unrelated frames a few per cent are valid by chance (default 0.15; 0 accepts any).
    smoothing_px : float
        Standard deviation of the smoothing of the predictor between passes (default a quarter of the last window).
    denoise : float
        Detail below the resolution is kept if it is stronger than this many times the noise; 0 keeps all (default
        2).
    extra_passes : int
        Maximum number of passes added while vectors still change (default 3).
    outlier_threshold : float
        Largest normalised residual of a valid vector, universal outlier detection (default 3).
    outlier_epsilon_px : float
        Noise level in the normalisation of that residual (default 0.1).
    peak_ratios : bool
        Compute the peak ratio of all vectors, not only of suspected outliers.
    sigma_w_m_s : float
        Standard deviation of the out-of-plane velocity from pair to pair [m/s], for the uncertainty of vectors and
        stresses (default: from the variation of u and v around each vector).
    w_over_u : float
        Mean out-of-plane velocity over in-plane speed, for the uncertainty of vectors and mean; 0: none (default:
        from the variation of u and v around each vector).
    prepare : list of str
        Preprocessing of frames, in order, such as sliding-minimum,min-max; or none (default for a flow run:
        sliding-minimum).
    """

    piv: Path | str
    first_window_px: Side | None
    final_window_px: Side
    finest_window_px: Side | None
    passes: Annotated[int, Interval(ge=1, le=20)] | None
    overlap: Overlap
    window: Window
    window_sigma: WindowSigma
    min_valid: MinValid
    least_valid: Annotated[float, Interval(ge=0.0, le=1.0)]
    smoothing_px: NotNegative | None
    denoise: NotNegative
    extra_passes: ExtraPasses
    outlier_threshold: AboveZero
    outlier_epsilon_px: AboveZero
    peak_ratios: bool
    sigma_w_m_s: NotNegative | None
    w_over_u: NotNegative | None
    prepare: Annotated[list[str], steps] | None


@dataclass(frozen=True)
class PivChoice:
    """Settings of the correlation, preprocessing of the frames, and out-of-plane motion.

    A preparation that is None is the usual one for the kind of run.
    """

    settings: PivSettings
    preparation: Preparation | None
    out_of_plane: OutOfPlane = NOTHING_TOLD
    least_valid: float = LEAST_VALID


class _Settings(Table):
    """A file of settings, made the values that an evaluation takes."""

    def choice(self) -> PivChoice:
        """Return them; PairError if they contradict each other."""
        given = self.model_dump(exclude_unset=True)
        least_valid = given.pop("least_valid", LEAST_VALID)
        prepare, window = given.pop("prepare", None), given.pop("window", "gaussian")
        final, finest = given.pop("final_window_px", None), given.pop("finest_window_px", None)
        sides = windows_of(given.pop("first_window_px", None), final or FINAL_PX, given.pop("passes", None))
        if final is None and finest is None and len(sides) > 1:
            finest = FINEST_PX
        if window == "square":
            given["window_sigma"] = 0.0
        through = OutOfPlane(given.pop("sigma_w_m_s", None), given.pop("w_over_u", None))
        settings = PivSettings(windows_px=sides, finest_px=finest, **given)
        preparation = None if prepare is None else Preparation(tuple(prepare))
        return PivChoice(settings, preparation, through, least_valid)


_KEYS: dict[str, Any] = {
    name: (kind, None) for name, kind in get_type_hints(PivOptions, include_extras=True).items() if name != "piv"
}
PivTable = create_model("PivTable", __base__=_Settings, **_KEYS)  # the keys of the file are those of PivOptions


def windows_of(first_px: int | None, final_px: int, passes: int | None) -> tuple[int, ...]:
    """Sides of the windows of all passes.

    Parameters
    ----------
    first_px : int, optional
        Side of the first pass; default 64, or twice the last one if that is more.
    final_px : int
        Side of the last pass.
    passes : int, optional
        How many; default as many as it takes to come down to the last side, and two more with it, at least four.

    Raises
    ------
    PairError
        The first window is smaller than the last one, or so few passes do not come down to it.
    """
    side = first_px if first_px is not None else (final_px if passes == 1 else max(64, LARGEST_FIRST * final_px))
    if side < final_px:
        raise PairError(f"the first window ({side} px) is smaller than the last one ({final_px} px)")
    sides = [side]
    while sides[-1] > final_px:
        sides.append(max(final_px, sides[-1] // 2))
    count = passes if passes is not None else max(4, len(sides) + 2)
    if count < len(sides):
        raise PairError(
            f"it takes {len(sides)} passes from {side} px to {final_px} px, not {count}; see --first-window"
        )
    return (*sides, *[final_px] * (count - len(sides)))


def piv_choice(**options: Unpack[PivOptions]) -> PivChoice:
    """Settings from a file, with what is given besides in their place.

    Parameters
    ----------
    **options
        See `PivOptions`.

    Raises
    ------
    ConfigError
        The file, or a value, is not what it should be.
    """
    given = dict(options)
    file, prepare = given.pop("piv", None), options.get("prepare")
    given["prepare"] = None if prepare is None else list(prepare)  # Python may give a tuple
    document = load_yaml(str(file)) if file is not None else Document(Path("settings"), {})
    if isinstance(document.tree, dict):
        document.tree |= {name: value for name, value in given.items() if value is not None}
    table = validate(document, PivTable)
    try:
        return table.choice()
    except PairError as error:
        raise ConfigError(document.path, [Problem(0, str(error))]) from None
