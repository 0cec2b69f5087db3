"""Last steps of every picture: names that fit, and a file that is written atomically."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from ground.whole_file import whole_file

MAX_LABEL_LETTERS = 18


def short(name: str, longest: int = MAX_LABEL_LETTERS) -> str:
    """Return a name that fits a picture; the middle of a long one is left out."""
    half = (longest - 1) // 2
    return name if len(name) <= longest else f"{name[:half]}\N{HORIZONTAL ELLIPSIS}{name[-half:]}"


if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Of zlib: half of the time of 4, and where pictures are noise a third fewer bytes; else a tenth more.
PNG_LEVEL = 2


def save_picture(figure: "Figure", path: Path, dpi: int) -> None:
    """Write a figure as PNG; OSError names the file if it cannot be written."""
    with whole_file(path) as stream:
        write_png(figure, stream, dpi)


def write_png(figure: "Figure", stream: BinaryIO, dpi: int) -> None:
    """Draw a figure once and write it as PNG.

    `savefig` draws it twice, images and all, the first time with a pen that leaves no trace.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.image import imsave

    canvas: Any = FigureCanvasAgg(figure)
    lay_out(figure, dpi)
    canvas.draw()
    about = {"compress_level": PNG_LEVEL}
    imsave(stream, canvas.buffer_rgba(), format="png", origin="upper", dpi=dpi, pil_kwargs=about)


def lay_out(figure: "Figure", dpi: float) -> None:
    """Place everything in a figure that places its own parts, for good.

    Matplotlib draws such a figure twice to save it, and throws the first drawing away.
    """
    figure.set_dpi(dpi)
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine("none")
