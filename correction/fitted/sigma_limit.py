"""Leave out what the map does not know well enough: crescents behind a chain of balls, nodes beside a fold.

Most of a fitted map is known to thousandths of a pixel; where the view turns wildly with every number of the
scene, by tenths.  How much is too much is the user's to say.  Sigma is asked at every STEP-th node; each answer
stands for the nodes around it, and the worst of its neighbours counts, so that little that is worse comes through.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.errors import MapUsageError
from correction.fitted.scene_sigma import SceneSigma
from correction.maps.correction_map import CorrectionMap
from correction.node_status import NodeStatus
from tracer.scene.scene import Scene

STEP = 4  # nodes between those asked


@dataclass(frozen=True)
class SigmaLimit:
    """Largest standard deviation of the map that is still used.

    Parameters
    ----------
    sigma : SceneSigma
        Of the scene.
    limit_px : float
        Corrected pixels, the worse axis.

    Raises
    ------
    MapUsageError
        The limit is not positive.
    """

    sigma: SceneSigma
    limit_px: float

    def __post_init__(self) -> None:
        if not self.limit_px > 0.0:
            raise MapUsageError(
                f"a limit of sigma of {self.limit_px:g} px leaves nothing; give some pixels, such as 0.1"
            )

    def within(self, found: CorrectionMap, scene: Scene) -> CorrectionMap:
        """Return the map with its nodes beyond the limit UNSURE, and nothing shown there.

        Raises
        ------
        StaleMap
            Map and scene are not those of the fit.
        """
        self.sigma.check(scene)
        found.check(scene)
        beyond = self._beyond(found, scene) & found.recovered
        status = np.where(beyond, np.uint8(NodeStatus.UNSURE), found.status)
        return replace(
            found,
            status=status,
            pixel=np.where(beyond[..., None], np.nan, found.pixel),
            weight=np.where(beyond, np.float32(0.0), found.weight),
        )

    def _beyond(self, found: CorrectionMap, scene: Scene) -> NDArray[np.bool_]:
        """Nodes (h, w) that may be beyond the limit; those that are not recovered, too, as it happens."""
        height, width = found.grid.shape
        chosen = found.status[::STEP, ::STEP] == NodeStatus.RECOVERED
        pixels, glass = found.pixel[0, ::STEP, ::STEP], found.branch[0, ::STEP, ::STEP] != 0
        worst = np.zeros(chosen.shape)
        for behind in (False, True):
            here = chosen & (glass == behind)
            seen = scene if behind else scene.bare()
            spread = self.sigma.sigma(seen, pixels[here]) / found.grid.pitch_mm
            worst[here] = np.nan_to_num(spread.max(axis=1), nan=np.inf)
        worst = scipy.ndimage.maximum_filter(worst, 3)
        return np.asarray(np.repeat(np.repeat(worst, STEP, 0), STEP, 1)[:height, :width] > self.limit_px)
