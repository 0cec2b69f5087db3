"""The light of the simulated world: pulses of a laser on a flow, and a lamp of many colours on a target.

**A flow** (`LitFlow`) is dark until a laser fires: exposures show the light that fell while the shutter was open.
The simulated laser reports every flash: `flash(0, t)` for light 1, `flash(1, t)` for light 2, in ns of
the machine's monotonic clock, before the exposure that holds it has been read out.  Light 1 begins a pair, with
particles of its own; light 2 shows the same particles where they have gone by then.  An exposure without light is
dark, one with two flashes shows both, and light 2 without a light 1 before it shows a pair that was not begun.

Without any laser on the bench light is taken to fall at the start of every exposure, as with a lamp that the
camera switches: an exposure within `LONGEST_DT_S` behind the last light 1 shows its light 2.

**The target** is shown in the light of `fit.light` in the scene file (`target_light`).  A picture in light of many
colours is the sum of pictures in each of them, so the target is rendered at a few single wavelengths and added up;
every glass has its own index at each.  A spectrum of more than COLOURS lines is replaced by the COLOURS nodes of
its Gauss quadrature: wavelengths and weights that have its mean, its width and all moments up to the one of order
2 COLOURS - 1.  They come from the polynomials that are orthogonal under the spectrum, whose three-term recurrence

    p_{k+1} = (x - a_k) p_k - b_k p_{k-1}

is a symmetric tridiagonal matrix with a_k on and sqrt(b_k) beside its diagonal: its eigenvalues are the nodes, and
the squares of the first components of its eigenvectors the weights.  Particles are always lit by the laser, at the
scene's own wavelength.
"""

import threading
from collections import deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.bench.bench_table import Bench
from sim.flow.images import Flashed, FlowCamera
from tracer.light import Light
from tracer.light_table import LightTable
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene
from tracer.scene.scene_file import load_priors

Frame = NDArray[np.uint16]
LONGEST_DT_S = 0.02
KEPT_FLASHES = 4096
COLOURS = 4  # of a lamp: two neighbours of a white LED lie half a pixel apart behind two balls
Colours = tuple[tuple[float, float], ...]  # wavelength [nm] and share of each


class Flash(NamedTuple):
    """One pulse of light, when it is, and whether there are particles that it meets."""

    time_ns: int
    lit: Flashed
    is_seeded: bool


class LitFlow:
    """Frames of a flow that a laser lights.

    Parameters
    ----------
    first_pair : int
        Number of the first pair; a world that goes on must show none of its pairs again.
    since_s : float
        What time it is in the flow at the first flash.
    """

    def __init__(self, first_pair: int = 0, since_s: float = 0.0) -> None:
        self._flashes: deque[Flash] = deque(maxlen=KEPT_FLASHES)
        self._next_pair = first_pair
        self._since_s = since_s
        self._is_seeded = True
        self._begun: Flash | None = None
        self._start_ns: int | None = None
        self._lock = threading.Lock()
        self.has_laser = False

    def seed(self, is_open: bool) -> None:
        """Open or close the seeding, for all light from now on."""
        with self._lock:
            self._is_seeded = is_open

    def flash(self, pulse: int, time_ns: int) -> None:
        """Tell of light 1 (`pulse` 0) or light 2 (1) at a time; may be ahead of it."""
        with self._lock:
            self.has_laser = True
            self._flashes.append(self._flash(pulse, time_ns))

    def expose(self, camera: FlowCamera, start_ns: int, end_ns: int) -> Frame:
        """Return the frame of an exposure."""
        with self._lock:
            if self.has_laser:
                seen = [flash for flash in self._flashes if start_ns <= flash.time_ns < end_ns]
            else:
                is_second = self._begun is not None and start_ns - self._begun.time_ns <= LONGEST_DT_S * 1e9
                seen = [self._flash(1 if is_second else 0, start_ns)]
        if not seen:
            return camera.dark(start_ns % 2**40)
        return camera.expose_flashes([flash.lit for flash in seen], is_seeded=seen[0].is_seeded)

    def _flash(self, pulse: int, time_ns: int) -> Flash:
        if self._start_ns is None:
            self._start_ns = time_ns
        if pulse == 1 and self._begun is not None:
            first = self._begun
            since_s = 1e-9 * (time_ns - first.time_ns)
            self._begun = None
            return Flash(time_ns, Flashed(first.lit.pair, 1, since_s, first.lit.time_s), first.is_seeded)
        time_s = self._since_s + 1e-9 * (time_ns - self._start_ns)
        flash = Flash(time_ns, Flashed(self._next_pair, pulse, 0.0, time_s), self._is_seeded)
        self._next_pair += 1
        self._begun = flash if pulse == 0 else None
        return flash


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
