"""A frame before and after the correction, for a page: small pictures, and figures that say what it cost."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.maps.corrector import Corrector
from correction.node_status import NodeStatus
from daq.runs.run_views import tells_a_scale_alone
from ground.rows import map_parts
from piv.preprocessing.image_figures import ImageFigures, image_figures
from rtpiv.analysis.gaps import Gaps, gaps_of_scene
from rtpiv.analysis.pictures.rasters import data_address, grey, mask_picture, tint
from rtpiv.analysis.through_glass import ThroughGlass, through_glass
from tracer.scene.scene import Scene

CORRECTED, PLAIN = "corrected", "evaluated"


@dataclass(frozen=True)
class BeforeAfter:
    """Small pictures and figures of a frame and its correction.

    Parameters
    ----------
    layers : tuple of (str, str)
        Name and data address of pictures that lie over each other: acquired (if of the same size), corrected,
        mask. Of frames of which a scale alone is known what is evaluated, and a mask only where some is.
    shares : dict
        Status -> share of the nodes, 0 to 1, of those that occur.
    full_scale : float
        Grey level at which a pixel counts as saturated.
    figures : dict
        ``acquired`` and ``corrected`` (or ``evaluated``) -> figures of merit.
    through : ThroughGlass, Gaps or None
        How much of what the balls hide is recovered, or of the gaps inside a bed; None if they hide nothing.
    """

    layers: tuple[tuple[str, str], ...]
    shares: dict[NodeStatus, float]
    full_scale: float
    figures: dict[str, ImageFigures]
    through: ThroughGlass | Gaps | None

    @property
    def recovered(self) -> float:
        """Share of the corrected frame that was recovered, 0 to 1."""
        return self.shares.get(NodeStatus.RECOVERED, 0.0)


def before_after(
    frame: NDArray[Any], corrected: NDArray[np.float32], corrector: Corrector, scene: Scene, full_scale: float
) -> BeforeAfter:
    """Look at a frame (H, W) as acquired, with its full scale, and (h, w) as corrected, NaN where nothing is."""
    name = PLAIN if tells_a_scale_alone(scene) else CORRECTED
    status = corrector.status
    pictures = _pictures(frame, corrected, corrector, name)
    if name == CORRECTED or (status != NodeStatus.RECOVERED).any():
        pictures["mask"] = lambda: mask_picture(status)
    counts = np.bincount(corrector.status.ravel(), minlength=len(NodeStatus))
    shares = {status: float(counts[status] / corrector.status.size) for status in NodeStatus if counts[status]}
    images = {"acquired": (frame, None), name: (corrected, corrector.recovered)}
    work: list[Callable[[], Any]] = [
        partial(image_figures, each, full_scale, seen) for each, seen in images.values()
    ]
    work += [partial(_small_picture, drawn) for drawn in pictures.values()]
    found = map_parts(lambda each: each(), work)
    figures = dict(zip(images, found, strict=False))
    layers = tuple(zip(pictures, found[len(images) :], strict=True))
    through = gaps_of_scene(scene) or through_glass(scene, corrector.map.grid, corrector.recovered)
    return BeforeAfter(layers, shares, full_scale, figures, through)


def layers_of(
    frame: NDArray[Any], corrected: NDArray[np.float32], corrector: Corrector
) -> tuple[tuple[str, str], ...]:
    """Return the layers of `BeforeAfter` for a frame as acquired and corrected, without the mask."""
    pictures = _pictures(frame, corrected, corrector, CORRECTED)
    return tuple(zip(pictures, map_parts(_small_picture, [*pictures.values()]), strict=True))


def _pictures(
    frame: NDArray[Any], corrected: NDArray[np.float32], corrector: Corrector, name: str
) -> dict[str, Callable[[], NDArray[np.uint8]]]:
    """Drawings of a frame as acquired, if it is of the size of the corrected one, and as corrected."""
    low, high = np.percentile(frame, (1.0, 99.0))
    limits = (float(low), float(high))
    status = corrector.status
    acquired = {"acquired": lambda: grey(frame, limits)} if frame.shape == corrected.shape else {}
    return acquired | {name: lambda: tint(grey(corrected, limits), status)}


def _small_picture(drawn: Callable[[], NDArray[np.uint8]]) -> str:
    return data_address(drawn())
