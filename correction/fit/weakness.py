"""What the frames cannot tell apart, in words, with the frames that would.

In units of the prior's sigmas the data's normal matrix N has eigenvalues lambda: along its eigenvector the
data know a number lambda times as well (in variance) as the prior did.  Where lambda is below LEARNED, the
answer is the prior's, not the frames'.  Beside that, numbers whose posterior correlation exceeds TIED are
nearly one unknown even if each alone is known well; those tied to each other, in a chain, are said together.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import connected_components

from correction.fit.result import SceneFit

LEARNED = 1.0
TIED = 0.97
SHARE = 0.3  # of a unit eigenvector, from which a number is named


@dataclass(frozen=True)
class Weakness:
    """A direction or a group of numbers that the frames leave open.

    Parameters
    ----------
    names : tuple of str
        The numbers concerned.
    sentence : str
        What it is and what would help.
    """

    names: tuple[str, ...]
    sentence: str


def weaknesses(fit: SceneFit) -> list[Weakness]:
    """Directions that the data leave to the prior, then numbers that are nearly one unknown."""
    found = []
    values, vectors = np.linalg.eigh(fit.normal)
    for value, vector in zip(values, vectors.T, strict=True):
        if value < LEARNED:
            names = tuple(n for n, share in zip(fit.names, vector, strict=True) if abs(share) > SHARE)
            text = f"{_list(names)}: the frames add nothing to the prior here"
            found.append(Weakness(names, f"{text}; {_cure(fit, names)}"))
    root = np.sqrt(np.diag(fit.covariance))
    tied = np.abs(fit.covariance / np.outer(root, root)) > TIED
    count, group = connected_components(tied, directed=False)
    for number in range(count):
        names = tuple(name for name, of in zip(fit.names, group, strict=True) if of == number)
        if len(names) > 1:
            text = f"{_list(names)} are nearly one unknown (correlation above {TIED:g})"
            found.append(Weakness(names, f"{text}; {_cure(fit, names)}"))
    return found


def _list(names: tuple[str, ...]) -> str:
    """Names in a row of words."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _cure(fit: SceneFit, names: tuple[str, ...]) -> str:
    """Frames or figures that would separate these numbers, given the frames there are."""
    stack = {glass: _heights(fit, glass) >= 3 for glass in (False, True)}
    if any(name.endswith((".n", ".z")) and not name.startswith(("camera.", "target")) for name in names):
        if not stack[True]:
            return "add target planes at -10 and -20 mm behind the glass, which separate depth from n"
        return "measure n or the radius on its own, or move the target farther"
    if any(name.endswith(".radius") for name in names):
        return "measure the radius (callipers, catalogue) and give its sigma in fit.spheres.radius_mm"
    if any(name in ("camera.focal_px", "camera.z") for name in names) or "target" in names[0]:
        if not stack[False]:
            return "add bare target frames at z = -20, -10, +10 and +20 mm"
        return "a stage known better than fit.target.z_mm, or a longer travel, would separate them"
    if not stack[False]:
        return "add bare target frames at -20 and +20 mm, which separate position from rotation"
    return "move the target farther along z"


def _heights(fit: SceneFit, glass: bool) -> int:
    """Number of heights of the target seen with or without glass."""
    views = {int(frame) for frame in fit.corners.frame[fit.corners.behind == glass]}
    return len(views)
