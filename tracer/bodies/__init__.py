"""Bodies: what stands between the camera and the investigation plane.

One file a kind.  A new kind needs its dataclass here, its rays in ``tracer/kernels`` and its line in the
scene file's table (``tracer/scene_file.py``); scenes without it pay nothing.
"""

from tracer.bodies.rod import Rod
from tracer.bodies.sphere import Core, Sphere

Body = Sphere | Rod

__all__ = ["Body", "Core", "Rod", "Sphere"]
