"""Cases of a dear test that are left to the slow suite (`make slow`).

What stays fast shows what no other case does; where all show the same, the hardest of the cheap ones stays.
"""

from collections.abc import Iterable, Sequence
from itertools import product
from typing import Any

import pytest


def slow(*values: Any, name: str | None = None) -> Any:
    """One case, of as many values as the test takes, that the slow suite runs."""
    return pytest.param(*values, marks=pytest.mark.slow, id=name)


def slow_but(names: Iterable[Any], *fast: Any) -> list[Any]:
    """All names, of which only the fast ones are no slow cases."""
    every = list(names)
    unknown = {*fast} - {*every}
    assert not unknown, f"no case is called {', '.join(sorted(map(str, unknown)))}"
    return [name if name in fast else slow(name) for name in every]


def one_in_three(*values: Sequence[Any]) -> list[Any]:
    """All combinations, of which each third, with every value in some of them, is no slow case."""
    places = product(*(range(len(each)) for each in values))
    chosen = [(sum(place) % 3 == 0, case) for place, case in zip(places, product(*values), strict=True)]
    return [case if is_fast else slow(*case) for is_fast, case in chosen]
