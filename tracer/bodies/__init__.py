"""Bodies: what stands between the camera and the investigation plane.

One file a kind, and its class in KINDS: ``docs/add-a-body.md``.  Scenes without a kind pay nothing for it.  The
place in KINDS is part of a scene's content hash: new kinds come last.
"""

from tracer.bodies.body import Body, BodySection, Capsule, shifted_by, vector3
from tracer.bodies.rod import Rod
from tracer.bodies.sphere import Core, Sphere

KINDS: tuple[type[Body], ...] = (Sphere, Rod)

__all__ = ["KINDS", "Body", "BodySection", "Capsule", "Core", "Rod", "Sphere", "shifted_by", "vector3"]
