"""Combinations that the frames leave open, in words, with the frames that would determine them.

In units of the prior's sigmas the data's normal matrix N has eigenvalues lambda: along its eigenvector the
data know a number lambda times as well (in variance) as the prior did.  Where lambda is below LEARNED, the
answer is the prior's, not the frames'.  Beside that, numbers whose posterior correlation exceeds TIED are
named as strongly correlated; those tied to each other, in a chain, stand together, unless each of them is known
well all the same, to LOOSE of what was known before.

Nor do they tell which gas is in a hollow ball (`two_gases`).  A thin shell bends light by so little that 2.8e-4 in
the index of what fills it, air against vacuum, looks like another index of the glass and another depth of the
ball: 1e-3 in n and 0.2 mm in z, with residuals as good as before and the sigmas of the fit unmoved.  The scene
must say one and the same.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from correction.fit.judge.result import SceneFit
from correction.fit.solve.considered import with_considered
from correction.fit.solve.unknowns import LENS, pose_label, unit_of
from tracer.bodies import Sphere
from tracer.harmonics import NAMES
from tracer.media import THINNEST_LIQUID
from tracer.scene.scene import Scene
from tracer.strategies.branches import branch_of

LEARNED = 1.0
# Bodies that are named, of more their number
LISTED = 3
TIED = 0.97
LOOSE = 0.05
WALL_CURE = (
    "measure the wall (callipers, level, catalogue) and give its sigma in fit.walls, if its numbers are wanted"
)
TILT_CURE = (
    "poses by hand, tilted by 10 to 30 degrees to several sides and far apart in depth"
    " (target_clear_pose1 and so on)"
)
NAMED_COMPONENT = 0.3  # of a unit eigenvector, from which a number is named
SAME_GAS = 1e-5  # in n: 10 K, or 30 hPa


@dataclass(frozen=True)
class Weakness:
    """A direction or a group of numbers that the frames leave open.

    Parameters
    ----------
    names : tuple of str
        The numbers concerned.
    sentence : str
        What it is and what would help.
    together : bool
        Whether the frames know these numbers, but one only with the others.
    """

    names: tuple[str, ...]
    sentence: str
    together: bool = False


def _of_light(fit: SceneFit) -> list[Weakness]:
    """Describe an uncertain light; one that contradicts fit.light is in the verdict, and is not repeated."""
    said = fit.light.sentence
    return [Weakness((), said)] if said and not fit.verdict.wrong_light else []


def weaknesses(fit: SceneFit) -> list[Weakness]:
    """Directions that the data leave to the prior, then strongly correlated numbers."""
    found = _of_light(fit)
    found += [Weakness((), sentence) for sentence in two_gases(fit.unknowns.scene)]
    wide = with_considered(fit.unknowns)
    if held := wide.names[len(fit.names) :]:
        sizes = zip(held, wide.sigma[-len(held) :].tolist(), strict=True)
        text = (
            f"held, but how well known is not said: {', '.join(f'{name} (say {size:g})' for name, size in sizes)}"
        )
        counted = "the map's sigma holds what the frames leave open of that"
        found.append(Weakness(held, f"{text}; {counted}; free them, or give their sigma in the fit section"))
    lost = {name for sphere in fit.unknowns.scene.spheres for name in _unseen(fit, sphere)}
    if lost:
        unseen = sorted({name.split(".")[0] for name in lost})
        places = "its place is" if len(unseen) == 1 else "their places are"
        text = f"no corner is seen through {', '.join(unseen)}: {places} what the scene file says"
        found.append(Weakness(tuple(n for n in fit.names if n in lost), f"{text}; smaller squares may show some"))
    values, vectors = np.linalg.eigh(fit.normal)
    of_walls = set(fit.unknowns.other_bodies.names)
    unknown: set[str] = set()
    # of one cure and quantity: one sentence
    open_: dict[tuple[str, str], tuple[str, ...]] = {}
    for value, vector in zip(values, vectors.T, strict=True):
        names = tuple(n for n, share in zip(fit.names, vector, strict=True) if abs(share) > NAMED_COMPONENT)
        if value < LEARNED and names and set(names) <= of_walls:
            unknown |= set(names)
        elif value < LEARNED and not set(names) <= lost:
            kind = _quantity(names) or ", ".join(names)
            cure = _cure(fit, names)
            open_[kind, cure] = (*open_.get((kind, cure), ()), *names)
    for (_, cure), names in open_.items():
        names = tuple(dict.fromkeys(names))  # a number may be in several directions
        text = f"{describe_numbers(fit, names)}: known no better than before, the frames do not show it"
        found.append(Weakness(names, f"{text}; {cure}"))
    found += _walls_unknown(fit, unknown)
    root = np.sqrt(np.diag(fit.covariance))
    tied = np.abs(fit.covariance / np.outer(root, root)) > TIED
    count, group = scipy.sparse.csgraph.connected_components(tied, directed=False)
    for number in range(count):
        members = group == number
        names = tuple(name for name, member in zip(fit.names, members, strict=True) if member)
        if len(names) > 1 and root[members].max() > LOOSE and not set(names) <= unknown:
            text = f"{describe_numbers(fit, names)} are strongly correlated"
            found.append(Weakness(names, f"{text}; {_cure(fit, names)}", together=True))
    return found


def _walls_unknown(fit: SceneFit, unknown: set[str]) -> list[Weakness]:
    """One sentence a wall: what frames do not tell of it, why that is so, and whether it matters."""
    found = []
    for body, _ in fit.unknowns.other_bodies.bodies:
        names = tuple(name for name in fit.names if name in unknown and name.startswith(f"{body.name}."))
        if names:
            text = f"{body.kind} {body.name}: {describe_numbers(fit, names)} known no better than before"
            why = "a camera a little elsewhere shows the same, and the map hardly depends on which"
            still = f" ({body.undetermined_note})" if body.undetermined_note else ""
            found.append(Weakness(names, f"{text}: {why}; its sigma holds the rest{still}; {WALL_CURE}"))
    return found


def _unseen(fit: SceneFit, sphere: Sphere) -> tuple[str, ...]:
    """Free numbers of a sphere through which the fitted scene shows no corner."""
    if any(sphere.is_on(branch_of(branch_name)) for branch_name in fit.expected):
        return ()
    return tuple(name for name in fit.names if name.startswith(f"{sphere.name}."))


def _quantity(names: tuple[str, ...]) -> str:
    """Quantity of which all names are, as radius_mm of several balls; "" where they differ."""
    parts = {name.rpartition(".")[2] for name in names}
    return parts.pop() if len(parts) == 1 else ""


def list_names(names: Sequence[str]) -> str:
    """Names in a row of words; of many, their number and the first of them."""
    if len(names) > LISTED:
        return f"{len(names)} bodies ({', '.join(names[: LISTED - 1])} and others)"
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def describe_numbers(fit: SceneFit, names: tuple[str, ...]) -> str:
    """Names in a row of words, each with its sigma."""
    sigma = dict(zip(fit.names, fit.sigmas.tolist(), strict=True))
    quantity = _quantity(names)
    if len(names) > LISTED and quantity:
        unit, factor = unit_of(names[0])
        wide = [sigma[name] * factor for name in names]
        ends = dict.fromkeys(f"{end:.2g}" for end in (min(wide), max(wide)))
        bodies = list_names([name.rpartition(".")[0] for name in names])
        return f"{quantity} of {bodies}: +-{' to '.join(ends)}{f' {unit}' if unit else ''}"
    words = []
    for name in names:
        unit, factor = unit_of(name)
        words.append(f"{name} (+-{sigma[name] * factor:.2g}{f' {unit}' if unit else ''})")
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def _cure(fit: SceneFit, names: tuple[str, ...]) -> str:
    """Frames or figures that would separate these numbers, given the frames there are."""
    if set(names) & set(fit.unknowns.other_bodies.names):
        stays = any(body.stays for body, _ in fit.unknowns.other_bodies.bodies)
        tilt = f"add {TILT_CURE}, or " if stays else ""
        return f"a wall and a camera elsewhere show nearly the same: {tilt}{WALL_CURE}"
    own = ("camera.", *map(pose_label, fit.unknowns.poses))
    lens = all(name.rpartition(".")[2] in LENS for name in names)  # these need boards at the borders of the view
    if fit.unknowns.poses and not lens and all(name.startswith(own) for name in names):
        return f"boards that are parallel or near each other leave it open: add {TILT_CURE}"
    if any(name.startswith("print.") for name in names):
        return "a print of another size shows the same: measure its bars (measured_mm in board.yaml, then --board)"
    stack = {glass: _heights(fit, glass) >= 3 for glass in (False, True)}
    spheres = [name for name in names if not name.startswith(("camera.", "target"))]
    if any(name.startswith("target") for name in names) and stack[False]:
        return (
            "this rests on how far the stage moved the target: a stage that is more accurate than fit.target.z_mm"
            " says, or a longer travel, would help"
        )
    if any(name.rpartition(".")[2] in NAMES for name in names):
        return (
            "rays through that side of the ball are too few or too alike, so that the map hardly depends on it"
            " either; fit.spheres.out_of_round_um says what is known"
        )
    if any(name.endswith((".n", ".z")) for name in spheres):
        if not stack[True]:
            return "add target planes at -10 and -20 mm behind the glass, which separate depth from n"
        return "measure n or the radius on its own, or move the target farther"
    if spheres:
        return "measure the radius (callipers, catalogue) and give its sigma in fit.spheres.radius_mm"
    if not stack[False]:
        return "add bare target frames at z = -20, -10, +10 and +20 mm"
    return "move the target farther along z"


def _heights(fit: SceneFit, glass: bool) -> int:
    """Number of heights of the target seen with or without glass."""
    views = {int(frame) for frame in fit.corners.frame[fit.corners.behind == glass]}
    return len(views)


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
