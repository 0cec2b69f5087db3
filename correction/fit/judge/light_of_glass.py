"""Light of the target frames, as the glass shows it.

No edge tells the wavelength of a single colour.  But glass that is called by its name has the index of its
catalogue, but for what melts differ by (`MELTS`), and in another light it has another.  With y_g how far the index
of glass g was found from what it should be in the specified light, r_g the change of its index with the
wavelength, and V the covariance of y by the frames alone and by melts, a light that is off by d nm shows y = r d,
so that

    d = r V^-1 y / (r V^-1 r) +- (r V^-1 r)^-1/2.

What frames alone know of y has the information L = S^-1 - P^-1, of the fit's covariance S and the prior's P, which
may be singular; then V^-1 = L - L (L + T^-1)^-1 L with T the variances of melts, and
V^-1 y = (1 - L (L + T^-1)^-1) S^-1 y.

Melts and frames tell d to 15 to 30 nm.  What is beyond that by more than chance is counted in the map's sigma,
which then covers an LED that was described as the laser; far beyond it is an alarm.
"""

from dataclasses import dataclass, replace

import numpy as np

from correction.fit.judge.result import SceneFit
from correction.fit.solve.unknowns import glasses
from tracer.light import Light
from tracer.media import MEDIA, MELTS, Medium
from tracer.scene.scene import Scene

BY_CHANCE = 2.0  # of the square of d in its sigmas, that is not counted
ALARM = 3.3  # sigmas: one right lab in a thousand


@dataclass(frozen=True)
class LightOfGlass:
    """Apparent error of the light's mean wavelength.

    Parameters
    ----------
    given : Light
        With what is not known of its mean.
    is_believed : bool
        Whether its file says how well its mean is known; then only an alarm counts against it.
    off_nm, sigma_nm : float
        What glass says, and how well it knows.
    """

    given: Light
    is_believed: bool
    off_nm: float
    sigma_nm: float

    @property
    def alarm(self) -> bool:
        """True if the light cannot be the specified one."""
        return bool(abs(self.off_nm) > ALARM * np.hypot(self.sigma_nm, self.given.unsure_nm))

    @property
    def unsure_nm(self) -> float:
        """Standard deviation of the mean wavelength in the light of what glass says."""
        if self.is_believed and not self.alarm:
            return self.given.unsure_nm
        beyond = self.off_nm**2 - BY_CHANCE * (self.sigma_nm**2 + self.given.unsure_nm**2)
        return float(np.sqrt(max(self.given.unsure_nm**2, beyond)))

    def __str__(self) -> str:
        """Return one sentence."""
        return (
            f"the light of the target frames seems to have a mean wavelength of"
            f" {self.given.mean_nm + self.off_nm:.0f} +- {self.sigma_nm:.0f} nm, not {self.given.mean_nm:.0f} as"
            " fit.light tells: so far is the index of the glass from its catalogue; look at the lamp's data sheet"
            " and at the name of the glass. The map's sigma holds the difference"
        )


def light_of_glass(fit: SceneFit, nominal: Scene, given: Light, is_believed: bool) -> LightOfGlass | None:
    """Compare glass that is called by its name with its catalogue; None where none tells.

    Parameters
    ----------
    fit : SceneFit
        In the specified light.
    nominal : Scene
        As its file has it, the glass as it is at the scene's wavelength.
    given : Light
    is_believed : bool
        As of `LightOfGlass`.
    """
    media = glasses(nominal)
    here = [number for number, name in enumerate(fit.names) if name in media]
    known = [media[fit.names[number]] for number in here]
    rate = np.array([replace(given, unsure_nm=1.0).index_sigma(medium) for medium in known])
    if not rate.any():
        return None
    prior = fit.unknowns.sigma[here]
    inverse = np.linalg.inv(fit.covariance[np.ix_(here, here)])
    seen = (inverse - np.eye(len(here))) / np.outer(prior, prior)
    melts = [_melt(medium, float(own)) for medium, own in zip(known, prior, strict=True)]
    left = np.linalg.solve(seen + np.diag(np.array(melts) ** -2), seen).T
    certain = float(rate @ (seen - left @ seen) @ rate)
    if not certain > 0.0:
        return None
    found = inverse @ fit.x[here] / prior
    return LightOfGlass(given, is_believed, float(rate @ (found - left @ found)) / certain, certain**-0.5)


def _melt(medium: Medium, prior: float) -> float:
    """Prior sigma of a glass's index: by its name, or from its file."""
    by_name = MELTS.get(medium.name) if MEDIA.get(medium.name) == medium else None
    return prior if by_name is None else min(by_name, prior)
