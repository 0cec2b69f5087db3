"""Gas in a hollow ball that is not the gas of the room: index and depth of the ball run away together.

A thin shell bends light by so little that 2.8e-4 in the index of what fills it, air against vacuum, looks like
another index of the glass and another depth of the ball: 1e-3 in n and 0.2 mm in z, with residuals as good as
before and the sigmas of the fit unmoved.  Frames cannot tell which gas it is; the scene must say one and the same.
"""

from tracer.media import THINNEST_LIQUID
from tracer.scene.scene import Scene

SAME_GAS = 1e-5  # in n: 10 K, or 30 hPa


def two_gases(scene: Scene) -> list[str]:
    """Sentences on hollow balls whose gas has another index than the room's."""
    room, found = scene.n_ambient, []
    for sphere in scene.spheres:
        for core in sphere.cores:
            inside = core.medium.n(scene.wavelength_nm)
            gases = max(inside, room) < THINNEST_LIQUID
            if gases and abs(inside - room) > SAME_GAS:
                found.append(
                    f"{sphere.name} is filled with gas of n {inside:.5f} and the room with n {room:.5f}: if both"
                    f" are air, {sphere.name}.z and n of its glass run away together by some 0.1 mm and 1e-3, and"
                    " no residual shows it; give the core material: air, which is the ambient's"
                )
    return found
