"""Status of the nodes of the plane: recovered, or the reason for which not."""

from enum import IntEnum

RECOVERED, RIM, FOLD, BLOCKED, OUT_OF_FRAME = 0, 1, 2, 3, 4  # as kernels see them
LOW_MAGNIFICATION, UNSURE, BLURRED, IN_GLASS = 5, 6, 7, 8
UNLISTED, UNCONFIRMED, LEFT_OUT = 9, 10, 11  # what a scene masks, and no view brings back
DARK, OVERLIT = 12, 13
EDGE = 14


class NodeStatus(IntEnum):
    """State of a node of the plane."""

    RECOVERED = RECOVERED
    RIM = RIM  # behind glass, and no pixel shows it
    FOLD = FOLD  # at or beyond a fold: two images merge and vanish
    BLOCKED = BLOCKED  # behind an opaque body
    OUT_OF_FRAME = OUT_OF_FRAME  # seen, but beside the sensor
    LOW_MAGNIFICATION = LOW_MAGNIFICATION  # resolution too low
    UNSURE = UNSURE  # the map's sigma is beyond the limit that was set
    BLURRED = BLURRED  # the aperture shows it too blurred, or too far from its chief ray
    IN_GLASS = IN_GLASS  # the plane runs through a body there
    UNLISTED = UNLISTED  # something that the scene does not list stands before it
    UNCONFIRMED = UNCONFIRMED  # the target did not confirm what the scene shows there
    LEFT_OUT = LEFT_OUT  # a person wants it so
    DARK = DARK  # bodies keep the light of the sheet away
    OVERLIT = OVERLIT  # bodies focus the light of the sheet there
    EDGE = EDGE  # behind a body with flat faces, and no pixel shows it


MEANING = {
    NodeStatus.RECOVERED: "recovered",
    NodeStatus.RIM: "hidden by the rim",
    NodeStatus.FOLD: "at or beyond a fold",
    NodeStatus.BLOCKED: "behind an opaque body",
    NodeStatus.OUT_OF_FRAME: "out of the frame",
    NodeStatus.LOW_MAGNIFICATION: "magnification below the limit",
    NodeStatus.UNSURE: "sigma of the map beyond the limit",
    NodeStatus.BLURRED: "blurred by the aperture",
    NodeStatus.IN_GLASS: "inside a body",
    NodeStatus.UNLISTED: "behind an unlisted body",
    NodeStatus.UNCONFIRMED: "not confirmed by the target",
    NodeStatus.LEFT_OUT: "left out by hand",
    NodeStatus.DARK: "too little light of the sheet",
    NodeStatus.OVERLIT: "light of the sheet focused there",
    NodeStatus.EDGE: "hidden by the edges of a body",
}
