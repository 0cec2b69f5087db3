"""Fit in the light of the target frames, hand out the scene in the light of the measurement.

Target frames are taken in LED light, particles in a laser's.  A glass's index differs by some 0.001-0.003
between the two, which is 0.2-2 px behind a ball.  In light of centre c and Gaussian width w (full, at half
height) a picture shows the mean index

    n_light = integral n(lambda) g(lambda) dlambda = n(c) + n''(c) w^2 / (16 ln 2) + ...

so the fit works with the glass moved by n_light - n(lambda_scene), and the constant that it finds, the melt's
own, stays when the glass is moved back.
"""

import numpy as np

from correction.fit.errors import ViewsMissing
from tracer.fit_section import FitLightTable
from tracer.media import VISIBLE_NM, ConstantMedium, Medium
from tracer.media import shifted as shifted_medium
from tracer.scene import Scene

WIDTHS = 2.5  # standard deviations of the light that are counted each way
NODES = 101


def index_in_light(medium: Medium, light: FitLightTable) -> float:
    """Mean refractive index in a light."""
    spread = light.width_nm / np.sqrt(8.0 * np.log(2.0))
    off = np.linspace(-WIDTHS, WIDTHS, NODES)
    lengths = np.clip(light.mean_nm + spread * off, *VISIBLE_NM)
    return float(np.average([medium.n(float(length)) for length in lengths], weights=np.exp(-0.5 * off**2)))


def in_light(scene: Scene, light: FitLightTable | None) -> Scene:
    """Return the scene with its glass as it looks in another light.

    Raises
    ------
    ViewsMissing
        A glass has no dispersion to move along.
    """
    return _moved(scene, scene, light, 1.0)


def back_from_light(fitted: Scene, nominal: Scene, light: FitLightTable | None) -> Scene:
    """Return a scene fitted in a light with its glass as it is at the scene's wavelength."""
    return _moved(fitted, nominal, light, -1.0)


def _moved(scene: Scene, nominal: Scene, light: FitLightTable | None, sign: float) -> Scene:
    """Move every glass by the difference that the nominal glass of the same body shows."""
    if light is None:
        return scene
    bodies = []
    for body, before in zip(scene.bodies, nominal.bodies, strict=True):
        changes = [sign * _change(was, body.name, nominal, light) for _, was in before.media]
        media = [shifted_medium(own, change) for (_, own), change in zip(body.media, changes, strict=True)]
        bodies.append(body.with_media(media))
    return scene.with_bodies(bodies)


def _change(medium: Medium, name: str, nominal: Scene, light: FitLightTable) -> float:
    """By how much the index of a medium of body `name` is higher in the light than at the scene's wavelength."""
    if not isinstance(medium, ConstantMedium):
        return index_in_light(medium, light) - medium.n(nominal.wavelength_nm)
    if medium.index == 1.0:  # what a hollow ball is filled with
        return 0.0
    raise ViewsMissing(
        f"the glass of {name} is a number without dispersion, which cannot be moved from"
        f" {light.mean_nm:g} to {nominal.wavelength_nm:g} nm; describe it as a glass, such as"
        " {base: N-BK7, offset: 0.0}"
    )
