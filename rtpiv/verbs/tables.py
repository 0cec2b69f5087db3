"""Tables for the terminal."""

from collections.abc import Collection, Iterable, Sequence
from typing import Any

from rich.table import Table

ALL = range(100)  # columns


def table_of(
    title: str | None,
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    left: Collection[int] = (0,),
    **style: Any,  # noqa: ANN401 - of rich
) -> Table:
    """Return a table for the terminal.

    Parameters
    ----------
    title : str or None
        Above the table.
    columns : sequence of str
        Their names.
    rows : iterable of sequence of str
        Cells of each row.
    left : collection of int, optional
        Columns with text, aligned left; numbers are aligned right.
    **style
        As for `rich.table.Table`.

    Returns
    -------
    rich.table.Table
        The table.
    """
    table = Table(title=title, **style)
    for number, name in enumerate(columns):
        table.add_column(name, justify="left" if number in left else "right", overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table
