"""Corners that a frame should show and does not: those whose windows the edge of the frame cuts tell nothing."""

import numpy as np

from correction.fit.seen.measurement import TargetFrame, glass_frame
from correction.target import Chessboard
from sim.demo.scenes import at_size, demo_scene
from tracer.strategies.sensitivity import TargetPose

SIDE_MM, SIDE_PX = 16.0, 29.5  # of the squares, in the frame


def test_corners_beside_the_edge_of_the_frame_are_not_called_hidden():
    """A row of the lattice 5 px from the edge was fitted in what is left of its windows, and masked as a body."""
    scene = at_size(demo_scene("two_spheres_500"), 300).bare()
    pose = TargetPose((0.0, 3.0 * SIDE_MM / SIDE_PX, 0.0))  # the last row 4.9 px from the edge
    noise = np.random.default_rng(1).normal(1000.0, 10.0, (300, 300)).astype(np.float32)
    frame = TargetFrame("glass", noise, True, 0.0)
    lost = glass_frame(frame, Chessboard(SIDE_MM, 0.4 * SIDE_MM), scene, pose, 0, False).lost.pixel
    assert len(lost) > 40
    assert lost.min() > 0.4 * SIDE_PX  # half a window
    assert lost.max() < 299.0 - 0.4 * SIDE_PX
