"""What is done to the frames of a flow, by name: at most one step to raw frames, then steps to corrected ones.

Raw frames lose their background, whose pixels stand still there; the correction follows; then particles are
brought to one height.  Every step is the same at every place of a frame, or takes off what does not move: none
moves a correlation peak.  What is not so is refused by name.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piv.errors import PairError
from piv.preprocessing.intensity_cap import intensity_capped
from piv.preprocessing.min_max import min_max_normalised

SLIDING_MINIMUM, MINIMUM, MEAN, POD, UNSEEDED = "sliding-minimum", "minimum", "mean", "pod", "unseeded"
RAW = {
    SLIDING_MINIMUM: "the smallest value within 4 frames of its pulse before and after is taken off",
    MINIMUM: "the smallest value in all frames of its pulse is taken off",
    MEAN: "the mean of all frames of its pulse is taken off",
    POD: "patterns that the frames of its pulse share are taken off",
    UNSEEDED: "the mean of the frames of its pulse that the run took without seeding is taken off",
}
CORRECTED = {
    "min-max": "particles are brought to one height within 10 x 10 px",
    "cap": "values above median + 2 deviations are cut to that",
}
REFUSED = {
    "clahe": "it changes a particle with its place in a tile, so it moves correlation peaks",
    "histogram": "it changes a particle with what lies around it, so it moves correlation peaks",
}


@dataclass(frozen=True)
class Preparation:
    """Steps in their order.

    Parameters
    ----------
    steps : tuple of str
        At most one of RAW, then those of CORRECTED, each once.

    Raises
    ------
    PairError
        A step that is unknown, refused, given twice, or in the wrong place.
    """

    steps: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for place, name in enumerate(self.steps):
            if name in REFUSED:
                raise PairError(f"{name} is no step for a measurement: {REFUSED[name]}; leave it out")
            if name not in RAW and name not in CORRECTED:
                raise PairError(f"there is no step {name!r} for frames; there are {', '.join((*RAW, *CORRECTED))}")
            if name in self.steps[:place]:
                raise PairError(f"the step {name} is given twice; give it once")
            if name in RAW and place:
                before = self.steps[place - 1]
                what = "only one background is taken off" if before in RAW else "raw frames come first"
                raise PairError(f"the step {name} stands behind {before}: {what}")

    @property
    def background(self) -> str | None:
        """The step for raw frames."""
        return next((name for name in self.steps if name in RAW), None)

    @property
    def said(self) -> list[str]:
        """What each step does, in a sentence."""
        return [(RAW | CORRECTED)[name] for name in self.steps]

    def finished(self, corrected: NDArray[Any], valid: NDArray[np.bool_]) -> NDArray[Any]:
        """Corrected frame (h, w), NaN where not `valid`, after the steps for corrected frames."""
        for name in self.steps:
            if name == "min-max":
                corrected = min_max_normalised(corrected, valid=valid)
            elif name == "cap":
                corrected = intensity_capped(corrected, valid)
        return corrected
