"""The light in which a simulated bench shows its target: that of `fit.light` in the scene file.

A picture in light of many colours is the sum of pictures in each of them, so the target is rendered at a few
single wavelengths and added up; every glass has its own index at each.  A spectrum of more than COLOURS lines is
replaced by the COLOURS nodes of its Gauss quadrature: wavelengths and weights that have its mean, its width and
all moments up to the one of order 2 COLOURS - 1.  They come from the polynomials that are orthogonal under the
spectrum, whose three-term recurrence

    p_{k+1} = (x - a_k) p_k - b_k p_{k-1}

is a symmetric tridiagonal matrix with a_k on and sqrt(b_k) beside its diagonal: its eigenvalues are the nodes, and
the squares of the first components of its eigenvectors the weights.

Particles are always lit by the laser, at the scene's own wavelength.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from daq.bench.bench_table import Bench
from tracer.light import Light
from tracer.light_table import LightTable
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene
from tracer.scene.scene_file import load_priors

COLOURS = 4  # of a lamp: two neighbours of a white LED lie half a pixel apart behind two balls
Colours = tuple[tuple[float, float], ...]  # wavelength [nm] and share of each


def target_light(bench: Bench) -> LightTable | None:
    """Return the light that the scene file tells of its target frames; None if it tells none.

    Raises
    ------
    ConfigError
        The `fit` section of the scene file is wrong.
    """
    return load_priors(bench.path.parent / bench.table.scene).light


def colours_of(light: Light) -> Colours:
    """Return the few wavelengths that stand for a light, with their shares.

    Parameters
    ----------
    light : Light
        Any number of wavelengths.

    Returns
    -------
    tuple of (float, float)
        At most COLOURS wavelengths [nm], ascending, and the share of each; 1 in sum.
    """
    lengths, shares = np.array(light.wavelength_nm), np.array(light.weight)
    lengths, shares = lengths[shares > 0.0], shares[shares > 0.0]
    if len(lengths) > COLOURS:
        lengths, shares = _nodes(lengths, shares)
    return tuple(zip(lengths.tolist(), shares.tolist(), strict=True))


def in_each_colour(scene: Scene, colours: Colours) -> tuple[tuple[Scene, float], ...]:
    """Return a scene as it is in each colour, with the share; one alone where no glass tells colours apart."""
    media = [medium for body in scene.bodies for _, medium in body.media]
    if all(isinstance(medium, ConstantMedium) for medium in media):
        return ((scene, 1.0),)
    return tuple((replace(scene, wavelength_nm=nm), share) for nm, share in colours)


def _nodes(x: NDArray[np.float64], w: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Gauss nodes (COLOURS,) and weights (COLOURS,) of the measure with weights w (N,) at x (N,)."""
    middle = float(w @ x)
    width = float(np.sqrt(w @ (x - middle) ** 2))
    x = (x - middle) / width
    before, now, norm = np.zeros_like(x), np.ones_like(x), 1.0
    diagonal, beside = [], []
    for _ in range(COLOURS):
        diagonal.append(float(w @ (x * now * now)))
        after = (x - diagonal[-1]) * now - norm * before
        norm = float(np.sqrt(w @ after**2))
        beside.append(norm)
        before, now = now, after / norm
    places, vectors = np.linalg.eigh(np.diag(diagonal) + np.diag(beside[:-1], 1) + np.diag(beside[:-1], -1))
    return middle + width * places, vectors[0] ** 2
