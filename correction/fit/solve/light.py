"""Fit in the light of the target frames, hand out the scene in the light of the measurement.

Target frames are taken in a lamp's light, particles in a laser's.  A glass's index differs by some 0.001-0.003
between the two, which is 0.2-2 px behind a ball.  A lamp shows the mean index over its colours (`tracer.light`),
so the fit works with the glass moved by n_light - n(lambda_scene), and the constant that it finds, the melt's own,
stays when the glass is moved back.

What is not known of the light is not known of the index either, and no frame tells: with N-BK7 8 nm are 3e-4 in n,
0.07 px behind two balls.  A light that is not specified may be any white lamp: the map is made as if it were the
scene's own, and its sigma holds the most that one of LAMPS would change.  All glasses move together, as they stand
in one light.  Glass that is a number has no dispersion to count by: it is said that its map holds in the light of
the target frames.

A width says little of a spectrum's shape, and its mean index goes by the variance: a flat band of 200 nm has half
that of the Gaussian of 200 nm at half height, 4e-4 in n.  The map's sigma holds what a rival of the same width
would change, as far as the smear of the edges leaves it open (`smear_test`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from correction.errors import ViewsMissing
from correction.fit.solve.other_bodies import OtherBodies
from tracer.light import Light, line, white_led
from tracer.media import MEDIA, THINNEST_LIQUID, ConstantMedium, Medium
from tracer.media import shifted as shifted_medium
from tracer.scene.scene import Scene
from tracer.strategies.sensitivity import CAMERA, SPHERE

ORDINARY_GLASS = "N-BK7"
WORTH_A_WORD = 3e-5  # of n: 0.005 px behind two balls
Rival = tuple[
    Light, float
]  # a light, and the share (0-1) of its difference from the specified one that is left open
LAMPS_K = (2700.0, 3000.0, 4000.0, 5000.0, 6500.0)  # white LEDs as they are sold


@dataclass(frozen=True)
class LightUncertainty:
    """Uncertainty of the light of the target frames.

    Parameters
    ----------
    step : (Q,) float64
        One standard deviation of it as a change of the scene's numbers (`SceneSigma`); empty if it is known.
    sentence : str
        What that is and what would help; empty if it is known.
    """

    step: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    sentence: str = ""


def in_light(scene: Scene, light: Light | None) -> Scene:
    """Return the scene with its glass as it looks in another light.

    Raises
    ------
    ViewsMissing
        A glass has no dispersion to move along.
    """
    return _shift_glass(scene, scene, light, 1.0)


def back_from_light(fitted: Scene, nominal: Scene, light: Light | None) -> Scene:
    """Return a scene fitted in a light with its glass as it is at the scene's wavelength."""
    return _shift_glass(fitted, nominal, light, -1.0)


def light_uncertainty(
    nominal: Scene, light: Light | None, rivals: Sequence[Rival] = (), particles_unsure_nm: float = 0.0
) -> LightUncertainty:
    """Return the uncertainty that this light leaves, in the numbers of the scene's camera, spheres and walls.

    Parameters
    ----------
    nominal : Scene
    light : Light or None
        As specified.
    rivals : sequence of Rival
        What it may be instead.
    particles_unsure_nm : float
        Standard deviation of the scene's wavelength; nothing depends on it where the target is seen in that light.
    """
    alike = light == line(nominal.wavelength_nm)
    flow = replace(line(nominal.wavelength_nm), unsure_nm=0.0 if alike else particles_unsure_nm)

    def unsure(medium: Medium | None) -> float:
        if medium is None or isinstance(medium, ConstantMedium):
            return 0.0
        parts = [index_sigma(medium, light, nominal.wavelength_nm), flow.index_sigma(medium)]
        if light is not None and rivals:
            here = light.index(medium)
            parts.append(max(abs(one.index(medium) - here) * open_ for one, open_ in rivals))
        return -float(np.linalg.norm(parts))

    sigma = [unsure(sphere.medium) for sphere in nominal.spheres]
    others = OtherBodies(nominal)
    walls = [
        unsure(body.media[0][1]) if number.known == "n" else 0.0
        for body, numbers in others.bodies
        for number in numbers
    ]
    if not any(sigma) and not any(walls):
        return LightUncertainty() if light else LightUncertainty(sentence=_of_numbers(nominal))
    of_spheres = np.zeros((len(sigma), len(SPHERE)))
    of_spheres[:, SPHERE.index("n")] = sigma
    rows = others.row_rates(np.array(others.start), glass=True) @ np.array(walls)
    step = np.concatenate((np.zeros(len(CAMERA)), of_spheres.ravel(), rows))
    largest = float(np.abs([*sigma, *walls]).max())
    if light is None:
        sentence = (
            "the light of the target frames is not said: glass is taken as it is at"
            f" {nominal.wavelength_nm:g} nm, and a white lamp may show its n off by {largest:.1g}; the map's sigma"
            " holds that. Give fit.light: points from the lamp's data sheet, or colour_temperature_k; or source:"
            " laser, if it is the laser of the measurement"
        )
    elif rivals:
        sentence = (
            "the spectrum of the target's light is not known well: from its specification and from how edges are"
            f" smeared n is known to {largest:.1g}; the map's sigma holds that. The lamp's spectrum as"
            " fit.light.points would help"
        )
        sentence = sentence if largest > WORTH_A_WORD else ""
    elif not light.unsure_nm:
        sentence = (
            f"the wavelength of the particles' light is known to {_nm(flow)} nm, n to {largest:.1g};"
            " the map's sigma holds that"
        )
    else:
        sentence = (
            f"the mean wavelength of the target's light is known to {_nm(light)} nm, n to {largest:.1g};"
            " the map's sigma holds that. The lamp's spectrum as fit.light.points would help; a laser is known"
            " exactly where fit.light says source: laser"
        )
    return LightUncertainty(step, sentence)


def _nm(light: Light) -> str:
    """Format the uncertainty of a mean wavelength with significant digits only."""
    return f"{light.unsure_nm:.0f}" if light.unsure_nm >= 10.0 else f"{light.unsure_nm:.1f}"


def _of_numbers(nominal: Scene) -> str:
    """Describe the glass whose index is a number, if there is any, where no light is specified."""
    glass = [
        sphere.name
        for sphere in nominal.spheres
        if isinstance(sphere.medium, ConstantMedium) and sphere.medium.index > THINNEST_LIQUID
    ]
    if not glass:
        return ""
    off = abs(index_sigma(MEDIA[ORDINARY_GLASS], None, nominal.wavelength_nm))
    return (
        f"the light of the target frames is not said, and the index of {', '.join(glass)} is a number without"
        f" dispersion: the map holds in the light of the target frames, nothing is counted for another (between a"
        f" white lamp and {nominal.wavelength_nm:g} nm the n of {ORDINARY_GLASS} differs by up to {off:.1g}). Give"
        f" fit.light, and the glass as one: {{base: {ORDINARY_GLASS}, offset: 0.0}};"
        " source: laser if target and particles are seen in one laser's light"
    )


@cache
def index_sigma(medium: Medium, light: Light | None, wavelength_nm: float) -> float:
    """Standard deviation of a medium's index between light and scene; 0 for a number, which has no dispersion."""
    if isinstance(medium, ConstantMedium):
        return 0.0
    if light is not None:
        return light.index_sigma(medium)
    here = medium.n(wavelength_nm)
    return -max(float(np.hypot(lamp.index(medium) - here, lamp.index_sigma(medium))) for lamp in _lamps())


def any_lamp(wavelength_nm: float) -> tuple[Light, ...]:
    """Lights that target frames are ordinarily taken in: white lamps, and the light of the measurement."""
    return (*_lamps(), line(wavelength_nm))


@cache
def _lamps() -> tuple[Light, ...]:
    return tuple(white_led(temperature) for temperature in LAMPS_K)


def _shift_glass(scene: Scene, nominal: Scene, light: Light | None, sign: float) -> Scene:
    """Move every glass by the difference that the nominal glass of the same body shows."""
    if light is None:
        return scene
    bodies = []
    for body, before in zip(scene.bodies, nominal.bodies, strict=True):
        changes = [sign * _change(was, body.name, nominal, light) for _, was in before.media]
        media = [shifted_medium(own, change) for (_, own), change in zip(body.media, changes, strict=True)]
        bodies.append(body.with_media(media))
    return scene.with_bodies(bodies)


def _change(medium: Medium, name: str, nominal: Scene, light: Light) -> float:
    """By how much the index of a medium of body `name` is higher in the light than at the scene's wavelength."""
    if not isinstance(medium, ConstantMedium):
        return light.index(medium) - medium.n(nominal.wavelength_nm)
    same = light.wavelength_nm == (nominal.wavelength_nm,)
    if medium.index < THINNEST_LIQUID or same:  # a hollow ball's gas has no dispersion worth a word
        return 0.0
    raise ViewsMissing(
        f"the glass of {name} is a number without dispersion, which cannot be moved from"
        f" {light.mean_nm:g} to {nominal.wavelength_nm:g} nm; describe it as a glass, such as"
        " {base: N-BK7, offset: 0.0}"
    )
