"""What a scene says of its frames, as lines for the page: a set for every view that a step of a plan can have."""

from typing import Any

from correction.errors import CorrectionError
from daq.live.outlines import outlines
from daq.plans.steps import BEHIND_GLASS, CLEAR
from ground.errors import GroundError
from piv.errors import PivError
from tracer.errors import TracerError
from tracer.scene.scene import Scene

LIT = "light sheet"  # view of a step that shows the light sheet through the glass


def scene_lines(scene: Scene, whole: bool) -> dict[str, dict[str, Any]]:
    """Lines by view.

    Parameters
    ----------
    scene : Scene
        As the run has it.
    whole : bool
        With folds and masks, which take kernels; a scene for which there are none has its outlines.
    """
    lines: dict[str, dict[str, Any]] = {}
    for view, seen in ((BEHIND_GLASS, scene), (CLEAR, scene.bare()), (LIT, scene.in_light_sheet())):
        if view != BEHIND_GLASS and seen == scene:
            lines[view] = lines[BEHIND_GLASS]
            continue
        lines[view] = outlines(seen)
        if whole:
            _add_folds(lines[view], seen)
    return lines


def _add_folds(lines: dict[str, Any], scene: Scene) -> None:
    """Add folds and masks of a scene to its outlines."""
    from daq.live.folds_and_masks import folds_and_masks

    try:
        found = folds_and_masks(scene)
    except (TracerError, CorrectionError, PivError, GroundError):
        return  # nothing is corrected there either, and whoever corrects has said why
    for name, kinds in found.items():
        lines[name] |= kinds
