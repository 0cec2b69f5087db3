"""Elements that axes of a bench carry, by name, and the directions of motion.

Frames of a run are read by these words; who does that does not wait for the models of benches.
"""

CAMERA, GLASS, TARGET = "camera", "glass", "target"
ELEMENTS = (CAMERA, GLASS, TARGET)
DIRECTIONS = "xyz"

Vector = tuple[float, float, float]
