"""How pairs are evaluated, from a YAML file and from the command line; what is given on the line wins.

    final_window_px: 16
    overlap: 0.75
    window: gaussian
    prepare: [sliding-minimum, min-max]

Windows are named by the first, the last, and how many passes there are: the side is halved from pass to pass
until it is the last one's, which then repeats.  `prepare` names what is done to frames, in order (see
`piv.preprocessing.preparation`); left out, each kind of run has its own.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, TypedDict, Unpack

from pydantic import Field

from ground.config import Document, Table, load_yaml, validate
from ground.errors import ConfigError, Problem
from piv.correlation.settings import SMALLEST_WINDOW_PX, PivSettings
from piv.errors import PairError
from piv.preprocessing.preparation import Preparation

Window = Literal["gaussian", "square"]
Side = Annotated[int, Field(ge=SMALLEST_WINDOW_PX, le=1024)]
LARGEST_FIRST = 2  # times the last window at least: a first window as small as that finds next to nothing


class PivOptions(TypedDict, total=False):
    """What every verb that correlates takes, one by one, in place of what the file says.

    Parameters
    ----------
    piv : Path, optional
        Settings of the correlation (docs/files.md).
    first_window, final_window : int, optional
        Side of the first and of the last windows [px].
    passes : int, optional
        How many.
    overlap : float, optional
        Of neighbouring windows.
    window : {"gaussian", "square"}, optional
        Their weights.
    denoise : float, optional
        0 keeps all detail.
    prepare : tuple of str, optional
        What is done to frames, in order; empty for nothing.
    """

    piv: Path | None
    first_window: int | None
    final_window: int | None
    passes: int | None
    overlap: float | None
    window: Window | None
    denoise: float | None
    prepare: tuple[str, ...] | None


@dataclass(frozen=True)
class PivChoice:
    """How pairs are evaluated, and what is done to their frames; None: as is usual for the kind of run."""

    settings: PivSettings
    preparation: Preparation | None


class PivTable(Table):
    """Keys of the file; what is not given has the default of `PivSettings`."""

    first_window_px: Side | None = None
    final_window_px: Side = 32
    passes: Annotated[int, Field(ge=1, le=20)] | None = None
    overlap: Annotated[float, Field(ge=0.0, lt=1.0)] = PivSettings.overlap
    window: Window = "gaussian"
    window_sigma: Annotated[float, Field(ge=0.15, le=2.0)] = PivSettings.window_sigma
    min_valid: Annotated[float, Field(gt=0.0, le=1.0)] = PivSettings.min_valid
    smoothing_px: Annotated[float, Field(ge=0.0)] | None = None
    denoise: Annotated[float, Field(ge=0.0)] = PivSettings.denoise
    extra_passes: Annotated[int, Field(ge=0, le=20)] = PivSettings.extra_passes
    outlier_threshold: Annotated[float, Field(gt=0.0)] = PivSettings.outlier_threshold
    outlier_epsilon_px: Annotated[float, Field(gt=0.0)] = PivSettings.outlier_epsilon_px
    peak_ratios: bool = False
    prepare: list[str] | None = None

    def settings(self) -> PivSettings:
        """Return what the evaluation takes."""
        apart = {"first_window_px", "final_window_px", "passes", "window", "window_sigma", "prepare"}
        return PivSettings(
            windows_px=windows_of(self.first_window_px, self.final_window_px, self.passes),
            window_sigma=self.window_sigma if self.window == "gaussian" else 0.0,
            **{name: getattr(self, name) for name in type(self).model_fields if name not in apart},
        )


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
    file = options.get("piv")
    document = load_yaml(file) if file is not None else Document(Path("settings"), {})
    prepare = options.get("prepare")
    given = {
        "first_window_px": options.get("first_window"),
        "final_window_px": options.get("final_window"),
        "passes": options.get("passes"),
        "overlap": options.get("overlap"),
        "window": options.get("window"),
        "denoise": options.get("denoise"),
        "prepare": None if prepare is None else list(prepare),
    }
    if isinstance(document.tree, dict):
        document.tree |= {name: value for name, value in given.items() if value is not None}
    table = validate(document, PivTable)
    try:
        return PivChoice(table.settings(), None if table.prepare is None else Preparation(tuple(table.prepare)))
    except PairError as error:
        raise ConfigError(document.path, [Problem(0, str(error))]) from None
