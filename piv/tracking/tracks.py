"""Two-frame particle tracking guided by correlation, for seeding too thin for windows.

A window needs five particles; below 0.003 particles per px one of 32 px holds fewer, and what it says is worth
less than one particle's own displacement, which has no window at all: 0.018 px each in any gradient (ADR 18).

1. Windows twice as large as usual predict where each particle of A appears in B, to within `REACH_PX`.
2. A pair of particles is a track if each is the other's nearest, and the next candidate is twice as far.
3. Tracks that contradict their eight nearest neighbours go. The others predict the displacement by a local plane,
   and all is matched anew within `FINE_PX`, twice: the windows' errors are gone from the prediction.
"""

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from piv.correlation.planes import fill_gaps
from piv.correlation.vector_field import VectorField
from piv.errors import PairError
from piv.tracking.particles import Particles

REACH_PX, FINE_PX = 3.0, 1.5
CLEARER = 2.0  # times as far the second candidate must be
NEIGHBOURS, USUAL_PX, LARGEST = 8, 0.15, 3.0  # held against so many; usual noise, largest normalised residual
FIT, FEWEST = 12, 6  # tracks of a local plane, and how many lie within its weights' reach
NARROWEST_PX = 16.0
FAR_PX = 1e6  # between particles that are seen in different ways

Floats = NDArray[np.float64]


class Tracks(NamedTuple):
    """Middle places (N, 2) [px], displacements (N, 2) [px], their standard uncertainties (N, 2); which particles.

    `first` and `last` (N,) count the particles of A and B.
    """

    place_px: Floats
    shift_px: Floats
    sigma_px: Floats
    first: NDArray[np.intp]
    last: NDArray[np.intp]


def track_particles(
    a: Particles,
    b: Particles,
    guide: VectorField,
    way_a: NDArray[np.int64] | None = None,
    way_b: NDArray[np.int64] | None = None,
) -> Tracks:
    """Tracks of particles that are found already.

    Parameters
    ----------
    a, b : Particles
        Of frames A and B.
    guide : VectorField
        Displacements, in the pixels that the places are in.
    way_a, way_b : ndarray of int64, shape (N,), optional
        How each is seen: particles seen in different ways are never partners.

    Raises
    ------
    PairError
        Fewer than nine particles match.
    """
    if way_a is not None and way_b is not None:
        a, b = separate_ways(a, b, way_a, way_b)
    tracks = _proven(match(a, b, _of_field(guide, a.place_px[:, :2]), REACH_PX))
    for _ in range(2):
        tracks = _proven(match(a, b, local_plane(tracks, a.place_px[:, :2]), FINE_PX))
    return tracks


def separate_ways(
    a: Particles, b: Particles, way_a: NDArray[np.int64], way_b: NDArray[np.int64]
) -> tuple[Particles, Particles]:
    """Give places a third coordinate that keeps those seen in different ways apart."""
    _, layer = np.unique(np.concatenate([way_a, way_b]), return_inverse=True)
    third_a, third_b = np.split(FAR_PX * layer[:, None], [len(way_a)])
    return (
        a._replace(place_px=np.hstack([a.place_px, third_a])),
        b._replace(place_px=np.hstack([b.place_px, third_b])),
    )


def match(a: Particles, b: Particles, shift_px: Floats, reach_px: float) -> Tracks:
    """Pairs of particles that are each other's nearest after `shift_px` (N, 2), and clearly so."""
    if len(a.place_px) < 2 or len(b.place_px) < 2:
        none = np.zeros(0, np.intp)
        return Tracks(*(np.zeros((0, 2)),) * 3, none, none)
    expected = a.place_px.copy()
    expected[:, :2] += shift_px
    far, there = scipy.spatial.cKDTree(b.place_px).query(expected, k=2)
    _, back = scipy.spatial.cKDTree(expected).query(b.place_px)
    one = there[:, 0]
    good = (back[one] == np.arange(len(one))) & (far[:, 0] < reach_px) & (far[:, 1] > CLEARER * far[:, 0])
    first, last = np.nonzero(good)[0], one[good]
    start, end = a.place_px[first, :2], b.place_px[last, :2]
    sigma = np.hypot(a.sigma_px[first], b.sigma_px[last])
    return Tracks(0.5 * (start + end), end - start, sigma, first, last)


def local_plane(tracks: Tracks, at_px: Floats) -> Floats:
    """Displacements (N, 2) at places (N, 2): planes through the nearest tracks, weighted by distance and sigma."""
    count = min(FIT, len(tracks.place_px))
    far, near = scipy.spatial.cKDTree(tracks.place_px).query(at_px, k=count)
    reach = np.maximum(far[:, min(FEWEST, count) - 1], NARROWEST_PX)[:, None]
    weight = np.exp(-np.square(far / reach)) / (np.square(tracks.sigma_px[near]).sum(axis=-1) + 1e-4)
    off = (tracks.place_px[near] - at_px[:, None]) / reach[..., None]
    terms = np.concatenate([np.ones((*off.shape[:2], 1)), off], axis=-1)
    normal = np.einsum("nki,nk,nkj->nij", terms, weight, terms)
    ridge = 1e-3 * np.trace(normal, axis1=1, axis2=2)[:, None, None]
    right = np.einsum("nki,nk,nkc->nic", terms, weight, tracks.shift_px[near])
    found: Floats = np.linalg.solve(normal + ridge * np.diag([0.0, 1.0, 1.0]), right)[:, 0]
    return found


def _of_field(field: VectorField, at_px: Floats) -> Floats:
    """Displacements (N, 2) of a field at places (N, 2), continued beyond its nodes."""
    vectors, _ = fill_gaps(np.nan_to_num(np.stack([field.u_px, field.v_px], axis=-1)), field.valid)
    across = scipy.interpolate.RegularGridInterpolator(
        (field.y_px, field.x_px), vectors, bounds_error=False, fill_value=None
    )
    found: Floats = across(at_px[:, ::-1])
    return found


def _proven(tracks: Tracks) -> Tracks:
    """Tracks that fit the median of their neighbours; PairError where there are too few."""
    if len(tracks.place_px) <= NEIGHBOURS:
        raise PairError(
            f"only {len(tracks.place_px)} particles match; check pairing and focus, or use windows where there are"
            " many"
        )
    _, near = scipy.spatial.cKDTree(tracks.place_px).query(tracks.place_px, k=NEIGHBOURS + 1)
    around = tracks.shift_px[near[:, 1:]]
    usual = np.median(around, axis=1)
    spread = np.median(np.linalg.norm(around - usual[:, None], axis=-1), axis=1)
    own = np.linalg.norm(tracks.sigma_px, axis=-1)  # behind a rim far more than usual
    good = np.linalg.norm(tracks.shift_px - usual, axis=-1) < LARGEST * (spread + USUAL_PX + own)
    return Tracks(*(part[good] for part in tracks))
