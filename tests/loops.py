"""Cheap cases in one test: a case of `parametrize` is collected and kept by every process of the tests."""

import inspect
from collections.abc import Callable, Iterable
from functools import wraps
from typing import Any

import pytest


def loop_over(names: str, cases: Iterable[Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Run a test once for each case, in a loop; every case that fails is named beside its error.

    For tests whose fixtures are the same to all cases: what one case writes or patches, the next one finds.

    Parameters
    ----------
    names : str
        Arguments of the test, with commas between them.
    cases : iterable
        Values of the arguments: tuples of them if there are several.
    """
    arguments = [name.strip() for name in names.split(",")]
    rows = [dict(zip(arguments, case if len(arguments) > 1 else (case,), strict=True)) for case in cases]
    assert rows, "a loop without cases tests nothing"

    def decorate(test: Callable[..., None]) -> Callable[..., None]:
        @wraps(test)
        def run(**fixtures: Any) -> None:
            errors: list[BaseException] = []
            for row in rows:
                try:
                    test(**fixtures, **row)
                except (Exception, BaseExceptionGroup, pytest.fail.Exception) as error:
                    error.add_note(
                        "in the case " + ", ".join(f"{name}={value!r:.200}" for name, value in row.items())
                    )
                    errors.append(error)
            if errors:
                raise BaseExceptionGroup(f"{len(errors)} of {len(rows)} cases failed", errors)

        given = inspect.signature(test)
        left = [each for name, each in given.parameters.items() if name not in arguments]
        run.__signature__ = given.replace(parameters=left)  # type: ignore[attr-defined]
        return run

    return decorate
