"""What is printed is what was written: brackets are units and paths, never markup."""

from rich.table import Table

from daq.terminal import console, error_console


def test_brackets_survive(capsys):
    table = Table(title="error [px]")
    table.add_column("u [px]")
    table.add_row("[/odd]")
    console().print("[bold]runs/[a]/x :name:", table)
    error_console().print("left [s]")
    printed = capsys.readouterr()
    for text in ("[bold]runs/[a]/x :name:", "error [px]", "u [px]", "[/odd]"):
        assert text in printed.out
    assert "left [s]" in printed.err
