"""A frame before and after the correction, for a page: small pictures, and figures that say what it cost."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.maps.corrector import Corrector
from correction.node_status import NodeStatus
from daq.runs.run_views import tells_a_scale_alone
from piv.preprocessing.image_figures import ImageFigures, image_figures
from rtpiv.analysis.pictures.rasters import data_address, grey, mask_overlay, mask_picture, tint
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
    through : ThroughGlass or None
        How much of what the balls hide is recovered; None if they hide nothing.
    """

    layers: tuple[tuple[str, str], ...]
    shares: dict[NodeStatus, float]
    full_scale: float
    figures: dict[str, ImageFigures]
    through: ThroughGlass | None

    @property
    def recovered(self) -> float:
        """Share of the corrected frame that was recovered, 0 to 1."""
        return self.shares.get(NodeStatus.RECOVERED, 0.0)


def before_after(
    frame: NDArray[Any], corrected: NDArray[np.float32], corrector: Corrector, scene: Scene, full_scale: float
) -> BeforeAfter:
    """Look at a frame (H, W) as acquired, with its full scale, and (h, w) as corrected, NaN where nothing is."""
    limits = (float(np.percentile(frame, 1)), float(np.percentile(frame, 99.0)))
    shown = tint(grey(corrected, limits), mask_overlay(corrector.status))
    name = PLAIN if tells_a_scale_alone(scene) else CORRECTED
    layers = [(name, data_address(shown))]
    if name == CORRECTED or (corrector.status != NodeStatus.RECOVERED).any():
        layers.append(("mask", data_address(mask_picture(corrector.status))))
    if frame.shape == corrected.shape:
        layers.insert(0, ("acquired", data_address(grey(frame, limits))))
    counts = np.bincount(corrector.status.ravel(), minlength=len(NodeStatus))
    shares = {status: float(counts[status] / corrector.status.size) for status in NodeStatus if counts[status]}
    named = {"acquired": (frame, None), name: (corrected, corrector.recovered)}
    figures = {name: image_figures(image, full_scale, which) for name, (image, which) in named.items()}
    through = through_glass(scene, corrector.map.grid, corrector.recovered)
    return BeforeAfter(tuple(layers), shares, full_scale, figures, through)
