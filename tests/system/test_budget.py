"""Size and wording of the code stay within `tests/budget.toml`."""

import ast

import pytest

from tests import budget

TEXT = '''"""Docstring
of two lines."""

# a comment
TEXT = """a string

# with lines that are no code elsewhere
"""


def moved(a, b):  # and a comment
    """Where it is."""
    return (
        a,

        b,
    )
'''


def test_no_row_is_above_its_budget():
    above = budget.rows_above(budget.count().rows, budget.budget())
    assert not above, "\n".join(above)


def test_every_row_has_a_budget_and_every_budget_a_row():
    rows = budget.Count(dict.fromkeys((*budget.PACKAGES, "benchmarks", "tests"), 1)).rows
    assert list(rows) == list(budget.budget())


def test_code_lines_are_those_without_comments_blank_lines_and_docstrings():
    assert budget.code_rows(TEXT, list(ast.walk(ast.parse(TEXT)))) == {5, 6, 7, 8, 11, 13, 14, 16, 17}


@pytest.mark.parametrize("ours", ["moved", "_drawn_anew", "held_still", "apart"])
def test_bare_participles(ours):
    assert budget.is_participle(ours)
    assert not budget.is_participle(f"is_{ours.strip('_')}")
