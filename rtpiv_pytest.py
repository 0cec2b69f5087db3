"""Fixtures for the tests of a lab, wherever rtpiv is installed: `rehearse`, and nothing that other tests notice.

pytest loads this file in every project of the computer, so it imports nothing until the fixture is asked for, not
even the package rtpiv: that makes room for folders of our names (ADR 20), which no stranger has asked for.

    def test_it_moves(rehearse):
        bench = rehearse("bench.yaml", seed=3)
        bench.home()
        bench.move(target_z=-5.0)
        assert abs(bench.true_mm()["target_z"] + 5.0) < 0.1

A test that has rehearsed fails at its end if something has truly passed a limit, come too close, or moved on
after a stop, and if a fault that it ordered has never struck, for then it has shown nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from sim.rehearsed import Rehearsed


@pytest.fixture
def rehearse() -> Iterator[Callable[..., Rehearsed]]:
    """Open the simulation of a bench file: `rehearse(bench, faults=, seed=)`; closed at its end."""
    import rtpiv  # noqa: F401 - makes room beside a sim.py of the lab
    from sim.rehearsed import Rehearsed

    opened: list[Rehearsed] = []
    with ExitStack() as stack:

        def open_one(*words: object, **named: object) -> Rehearsed:
            opened.append(stack.enter_context(Rehearsed(*words, **named)))  # type: ignore[arg-type]
            return opened[-1]

        yield open_one
    said = [each.event_log() for each in opened]  # the last words of a session are those of closing
    wrong = [f"the simulated world has seen: {seen}" for each in said for seen in each.violations]
    wrong += [f"a fault has never struck: {fault}" for each in said for fault in each.waiting]
    if wrong:
        pytest.fail("\n".join(wrong), pytrace=False)
