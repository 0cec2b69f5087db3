"""What is printed is what was written: brackets are units and paths, never markup."""

from rich.table import Table

from ground.terminal import console, error_console, progress


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


def test_a_bar_is_shown_only_after_its_time(capsys):
    assert list(progress(range(3), 3, "frames", after_s=1e9)) == [0, 1, 2]
    assert capsys.readouterr().err == ""
    assert list(progress(range(3), 3, "frames")) == [0, 1, 2]
    assert "frames" in capsys.readouterr().err
