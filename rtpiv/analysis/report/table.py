"""A table as a value: one for the page, the terminal and JSON."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import rich.table

    from rtpiv.analysis.report.page import Link

ALL_COLUMNS = range(100)
MAX_ROWS = 60  # of a table in a page; files have all


@dataclass(frozen=True)
class Table:
    """Text in rows and columns.

    Parameters
    ----------
    title : str
        What it shows, with the unit if that is the same in all columns; may be empty.
    columns : sequence of str
        Heads of the columns.
    rows : sequence of sequence of str or Link
        Cells, as many as columns.
    left : collection of int
        Columns of text, aligned left in a terminal; numbers are aligned right.
    """

    title: str
    columns: Sequence[str]
    rows: "Sequence[Sequence[str | Link]]"
    left: Collection[int] = (0,)

    def records(self) -> list[dict[str, Any]]:
        """Return each row by the heads of the columns."""
        return [dict(zip(self.columns, row, strict=True)) for row in self.rows]

    def __rich__(self) -> "rich.table.Table":
        """Render it in a terminal."""
        from rich.table import Table as RichTable

        table = RichTable(title=self.title)
        for number, column in enumerate(self.columns):
            table.add_column(column, justify="left" if number in self.left else "right", overflow="fold")
        for row in self.rows:
            table.add_row(*map(str, row))
        return table
