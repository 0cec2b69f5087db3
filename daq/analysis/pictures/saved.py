"""Pictures on the disk: whole or not there, whatever the disk does in the middle."""

from pathlib import Path

from daq.analysis.pictures.canvas import Figure
from ground.whole_file import whole_file


def save_picture(figure: Figure, path: Path, dpi: int) -> None:
    """Write a figure as PNG; OSError names the file if it cannot be written."""
    with whole_file(path) as stream:
        figure.savefig(stream, format="png", dpi=dpi)
