"""One self-contained HTML page: pictures, figures and tables that go straight into a lab book.

No script or style comes from anywhere else, and everything is embedded, so the page can be mailed and will look
the same in ten years.  Every text that came from a file or a name is escaped.
"""

import base64
import html
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tracer.whole_file import whole_file

WIDEST_PX = 1008  # pictures in the page; the full frames are files beside it

_STYLE = Path(__file__).with_name("report.css")


class Page:
    """A page that grows section by section.

    Parameters
    ----------
    title : str
        Heading and window title.
    """

    def __init__(self, title: str) -> None:
        self._title = title
        self._parts: list[str] = []

    def heading(self, text: str) -> None:
        """Start a section."""
        self._parts.append(f"<h2>{html.escape(text)}</h2>")

    def text(self, text: str) -> None:
        """Add a paragraph."""
        self._parts.append(f"<p>{html.escape(text)}</p>")

    def table(self, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Add a table; the first column is text, the others numbers."""
        top = "".join(f"<th>{html.escape(cell)}</th>" for cell in head)
        body = "".join(
            "<tr>" + "".join(f"<td>{html.escape(str(cell))}</td>" for cell in row) + "</tr>" for row in rows
        )
        self._parts.append(f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>")

    def svg(self, picture: bytes, caption: str) -> None:
        """Add a figure drawn as SVG."""
        encoded = base64.b64encode(picture).decode()
        source = f"data:image/svg+xml;base64,{encoded}"
        self._figure(f'<img alt="{html.escape(caption)}" src="{source}">', caption)

    def picture(self, image: NDArray[np.uint8], caption: str) -> None:
        """Add a picture, grey (H, W) or RGB (H, W, 3)."""
        self._figure(f'<img alt="{html.escape(caption)}" src="{_encoded(image)}">', caption)

    def slider(
        self, left: NDArray[np.uint8], right: NDArray[np.uint8], names: tuple[str, str], caption: str
    ) -> None:
        """Lay two pictures of the same shape over each other with a handle that uncovers one of them."""
        a, b = html.escape(names[0]), html.escape(names[1])
        self._figure(
            f'<div class="slider"><img alt="{a}" src="{_encoded(left)}">'
            f'<img class="over" alt="{b}" src="{_encoded(right)}">'
            f'<span class="tag left">{a}</span><span class="tag right">{b}</span>'
            '<input type="range" min="0" max="100" value="50" aria-label="uncover" '
            "oninput=\"this.parentNode.style.setProperty('--cut',this.value+'%')\"></div>",
            caption,
        )

    def html(self) -> str:
        """Return the whole page."""
        title, style = html.escape(self._title), _STYLE.read_text(encoding="utf-8")
        return (
            '<!doctype html><html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width,initial-scale=1">'
            f"<title>{title}</title><style>{style}</style></head><body><h1>{title}</h1>"
            + "".join(self._parts)
            + "</body></html>\n"
        )

    def write(self, path: Path) -> None:
        """Write the page, atomically."""
        with whole_file(path) as stream:
            stream.write(self.html().encode())

    def _figure(self, inner: str, caption: str) -> None:
        self._parts.append(f"<figure>{inner}<figcaption>{html.escape(caption)}</figcaption></figure>")


def grey(frame: NDArray[Any], limits: tuple[float, float]) -> NDArray[np.uint8]:
    """8-bit picture of a frame between two grey levels; NaN is dark blue if the result is made RGB by `tinted`."""
    low, high = limits
    scaled = (np.nan_to_num(frame.astype(np.float32), nan=low) - low) / max(high - low, 1e-9)
    return np.asarray(np.clip(scaled * 255.0, 0.0, 255.0), dtype=np.uint8)


def tinted(picture: NDArray[np.uint8], recovered: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """RGB picture in which everything that is not recovered is slate blue."""
    rgb = np.repeat(picture[..., None], 3, axis=-1)
    rgb[~recovered] = (56, 66, 92)
    return rgb


def _encoded(image: NDArray[np.uint8]) -> str:
    """Data address of a picture, reduced to WIDEST_PX."""
    height, width = image.shape[:2]
    if width > WIDEST_PX:
        size = (WIDEST_PX, round(height * WIDEST_PX / width))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    if image.ndim == 3:
        image = np.ascontiguousarray(image[..., ::-1])
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 88])
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode()
