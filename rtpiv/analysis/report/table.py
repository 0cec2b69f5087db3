"""A table as a value: one for the page, the terminal and JSON."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import rich.table

    from rtpiv.analysis.report.page import Link


@dataclass(frozen=True)
class Table:
    """Text in rows and columns; the first column is a name, the others are numbers.

    Parameters
    ----------
    title : str
        What it shows, with the unit if that is the same in all columns; may be empty.
    columns : sequence of str
        Heads of the columns.
    rows : sequence of sequence of str or Link
        Cells, as many as columns.
    """

    title: str
    columns: Sequence[str]
    rows: "Sequence[Sequence[str | Link]]"

    def records(self) -> list[dict[str, Any]]:
        """Return each row by the heads of the columns."""
        return [dict(zip(self.columns, row, strict=True)) for row in self.rows]

    def __rich__(self) -> "rich.table.Table":
        """Render it in a terminal."""
        from rich.table import Table as RichTable

        table = RichTable(title=self.title)
        for number, column in enumerate(self.columns):
            table.add_column(column, justify="right" if number else "left")
        for row in self.rows:
            table.add_row(*map(str, row))
        return table
