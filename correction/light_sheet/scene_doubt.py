"""What an unsure scene makes of the heights that two views tell.

If the scene is off by dx, the pixel that shows X in view a seems to show X + G_a dx (`SceneSigma.spread`), and
that of view b X + G_b dx.  The views then lie apart by (G_b - G_a) dx, which looks like the height

    (G_b - G_a) dx . D / |D|^2.

Behind two balls 10 um of a ball along the view are 0.17 mm of height; they are the same in all frames and nearly
so in all cells.
"""

import numpy as np
from numpy.typing import NDArray

from correction.fitted.scene_sigma import SceneSigma
from correction.light_sheet.double_views import DoubleViews, some_of_each
from tracer.scene.scene import Scene

PLACES = 12  # of a cell


def scene_doubt(
    scene: Scene, views: DoubleViews, cell: NDArray[np.int64], sigma: SceneSigma
) -> NDArray[np.float64]:
    """Spread (C, P) [mm] of the heights of cells; cells of one column belong to the same draw.

    Parameters
    ----------
    scene : Scene
        That of the views, in the plane of the map.
    views : DoubleViews
        N places seen twice.
    cell : (N,) int64
        Cell of each place, 0 ...
    sigma : SceneSigma
        Of the scene, as seen in this plane (`SceneSigma.in_light_sheet`); the plane's own is left out.
    """
    some = some_of_each(cell, PLACES)
    seen, cells = views.at(some), cell[some]
    glass = sigma.of_glass()
    first, second = (glass.spread(scene, np.ascontiguousarray(seen.chief_px[:, view])) for view in (0, 1))
    off = np.einsum("nip,ni->np", second - first, seen.towards / seen.parallax[:, None])
    good = np.isfinite(off).all(axis=1)
    total = np.zeros((int(cell.max()) + 1, off.shape[1]))
    np.add.at(total, cells[good], off[good])
    return np.asarray(total / np.maximum(np.bincount(cells[good], minlength=len(total)), 1)[:, None])
