"""Many drawn labs: wrong models that cost something are named, right ones are left alone, one sigma is one sigma.

A wrong model counts as named by an alarm alone: something that the data say and a right lab does not.  What is
said of the scene file whatever the frames show (a light not told, a number held) counts for nothing.

Corners lie off where the view bends, as they do on rendered frames and as sigma knows: where none did, one sigma
held 76 % of the map's errors in right labs.

``make labs LABS=100`` counts a hundred labs of each kind that cost more than COSTLY_PX, and prints what it finds.
"""

import os
from dataclasses import dataclass

import numpy as np
import pytest

from tests.correction.fit.drawn_labs import FAULTS, drawn_lab

FIRST = 91000  # no number in the fit was chosen on these seeds
KIND = 10000  # seeds from one kind of fault to the next
LABS = int(os.environ.get("LABS", "20"))
MOST = 8  # times LABS that are drawn of a kind until LABS are costly
COSTLY_PX = 0.05
TELLING = 40  # corners seen through a ball from which a fault of it must be named
OF_A_BALL = ("ellipsoid", "ball off")
CAUSE = {
    "ellipsoid": "not the sphere",
    "bent board": "board is not flat",
    "lens term": "lens term is missing",
    "ball off": "does not stand where it was held",
    "index": "glass was held",
    "support": "a support",
    "light": "more colours than fit.light gives",
}


@dataclass(frozen=True)
class Judged:
    """What a drawn lab shows."""

    fault: str
    is_costly: bool
    is_named: bool
    says_cause: bool
    covered: float  # share of the map's errors within one sigma
    held: float  # share of the squares of the map's errors that two sigmas hold
    chi: float  # root mean square of the map's error over its sigma
    corners: int  # seen through the faulty ball


def judged(seed: int, fault: str) -> Judged:
    lab = drawn_lab(seed, fault, pulled=float(np.random.default_rng((18, seed)).normal()))
    verdict = lab.fit.verdict
    named = not verdict.is_right
    cause = named and CAUSE.get(fault, "no cause") in " ".join(verdict.sentences)
    covered = float(np.mean(np.abs(lab.error_px) < lab.sigma_px))
    costly = lab.cost_px > COSTLY_PX or fault == "support"  # hidden corners cost the map next to nothing
    inside = np.abs(lab.error_px) < 2.0 * lab.sigma_px
    held = float(np.sum(lab.error_px**2 * inside) / np.sum(lab.error_px**2))
    seen = sum(way.corners for way in verdict.ways if lab.ball in way.way.split(" > "))
    chi = float(np.sqrt(np.mean((lab.error_px / lab.sigma_px) ** 2)))
    return Judged(fault, costly, named, cause, covered, held, chi, seen)


@pytest.fixture(scope="module")
def labs() -> list[Judged]:
    """Right labs, and of each fault as many as it takes until LABS of them are costly."""
    found = [judged(FIRST + n, "") for n in range(2 * LABS)]
    for number, fault in enumerate(FAULTS, start=1):
        costly = 0
        for n in range(MOST * LABS):
            found.append(judged(FIRST + KIND * number + n, fault))
            costly += found[-1].is_costly
            if costly == LABS:
                break
    return found


def of(labs: list[Judged], fault: str) -> list[Judged]:
    return [lab for lab in labs if lab.fault == fault]


def chi_of(labs: list[Judged]) -> float:
    """Root mean square of error over sigma, each lab counted once; NaN of none."""
    return float(np.sqrt(np.mean([lab.chi**2 for lab in labs]))) if labs else float("nan")


def says(labs: list[Judged]) -> str:
    rows = []
    for fault in ("", *FAULTS):
        own = of(labs, fault)
        costly = [lab for lab in own if lab.is_costly]
        unnamed = [lab.held > 0.95 for lab in costly if not lab.is_named]
        telling = [lab.is_named for lab in costly if lab.corners >= TELLING]
        rows.append(
            f"{fault or 'right':12s} {len(own):4d} labs, {sum(lab.is_named for lab in own):4d} alarms; of"
            f" {len(costly):3d} costly ones {sum(lab.is_named for lab in costly):3d} named, by the cause"
            f" {sum(lab.says_cause for lab in costly):3d}; one sigma covers"
            f" {np.mean([lab.covered for lab in own]):.2f}, chi {chi_of(own):.2f}, of the named"
            f" {chi_of([lab for lab in own if lab.is_named]):.2f}; two sigmas hold {sum(unnamed)} of"
            f" {len(unnamed)} that are not named; of {len(telling)} whose ball shows {TELLING} corners"
            f" {sum(telling)} are named"
        )
    return "\n" + "\n".join(rows)


@pytest.mark.slow
@pytest.mark.timeout(14400)
def test_right_labs_raise_no_alarm(labs):
    print(says(labs))
    right = of(labs, "")
    assert sum(lab.is_named for lab in right) <= max(1, 0.01 * len(right))


@pytest.mark.slow
@pytest.mark.timeout(14400)
@pytest.mark.parametrize("fault", FAULTS)
def test_wrong_labs_that_cost_something_raise_an_alarm(labs, fault):
    """A ball seen in fewer corners than TELLING hides its fault among its own numbers: counted, not judged."""
    costly = [
        lab for lab in of(labs, fault) if lab.is_costly and (lab.corners >= TELLING or fault not in OF_A_BALL)
    ]
    unnamed = [lab.held > 0.95 for lab in costly if not lab.is_named]
    assert len(costly) - len(unnamed) >= 0.95 * len(costly) - 1  # one by chance
    assert all(unnamed) or len(unnamed) <= 1


@pytest.mark.slow
@pytest.mark.timeout(14400)
def test_two_thirds_of_map_errors_lie_within_one_sigma_in_right_and_wrong_labs(labs):
    right = np.mean([lab.covered for lab in of(labs, "")])
    wrong = np.mean([np.mean([lab.covered for lab in of(labs, fault)]) for fault in FAULTS])
    assert 0.60 <= right <= 0.75
    assert 0.60 <= 0.5 * (right + wrong) <= 0.75


@pytest.mark.slow
@pytest.mark.timeout(14400)
@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_named_is_in_sigma_as_large_as_it_is(labs, fault):
    """The error of a named lab is known, but for noise: it is what the fault makes, and so is sigma, everywhere.

    Whether one then lies within the other is a toss of a coin; their ratio says whether sigma is true.  A light
    that nobody told is no draw but a bound: sigma holds the most that a white lamp would do.
    """
    named = chi_of([lab for lab in of(labs, fault) if lab.is_named])
    assert named <= 1.25
    assert named >= 0.8 or fault == "light"


@pytest.mark.slow
@pytest.mark.timeout(14400)
def test_the_cause_that_is_named_is_the_fault(labs):
    named = [lab for lab in labs if lab.fault and lab.is_named]
    assert np.mean([lab.says_cause for lab in named]) >= 0.9
