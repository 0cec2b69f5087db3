"""What the axes of a bench carry, by name, and the directions that they move it along.

Frames of a run are read by these words; who does that does not wait for the models of benches.
"""

CAMERA, GLASS, TARGET = "camera", "glass", "target"
ELEMENTS = (CAMERA, GLASS, TARGET)
DIRECTIONS = "xyz"

Vector = tuple[float, float, float]
