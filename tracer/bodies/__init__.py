"""Bodies: what stands between the camera and the investigation plane.

One file a kind, and its class in KINDS: ``docs/add-a-body.md``.  Scenes without a kind pay nothing for it.  The
place in KINDS is part of a scene's content hash: new kinds come last.
"""

from tracer.bodies.block import Block, Box, Prism
from tracer.bodies.body import (
    CONTACT_TOL_MM,
    Body,
    BodySection,
    Capsule,
    Carrier,
    Index,
    Number,
    Piece,
    Room,
    translate_by,
    vector3,
)
from tracer.bodies.dome import Dome
from tracer.bodies.mesh import Mesh
from tracer.bodies.rod import Rod
from tracer.bodies.sphere import Core, Sphere
from tracer.bodies.tube import Tube
from tracer.bodies.window import Window

KINDS: tuple[type[Body], ...] = (Sphere, Rod, Window, Tube, Dome, Mesh, Block)

__all__ = [
    "CONTACT_TOL_MM",
    "KINDS",
    "Block",
    "Body",
    "BodySection",
    "Box",
    "Capsule",
    "Carrier",
    "Core",
    "Dome",
    "Index",
    "Mesh",
    "Number",
    "Piece",
    "Prism",
    "Rod",
    "Room",
    "Sphere",
    "Tube",
    "Window",
    "translate_by",
    "vector3",
]
