"""A page on which a person draws what is to be left out of a frame; it becomes a picture, white where that is.

    browser: token                       -> page: words (name, outlines so far), then the frame, one byte a pixel
    browser: {"outlines": [[[u, v] ...]]} -> page: {"saved": ..., "share": ...} or {"refused": one sentence}

The picture is written whole or not at all.  The page can write this one file and do nothing else; a viewer who is
let in is decided as for the live page (`daq.live.local_page`).
"""

import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection

from correction.masked import pixels_in
from daq.atomic_write import why
from daq.live.local_page import PageServer, page_files, parse_message
from daq.live.picture import grey_bytes
from ground.whole_file import whole_file
from tracer.masked import LEFT_OUT, MaskedPart, Point

SOCKET = "/outlines"
PAGES = page_files("mask.html", "mask.js")
MAX_MESSAGE_BYTES = 4_000_000  # of a message
MOST_OUTLINES, MOST_POINTS = 1000, 100_000
MAX_OUTLINE_PX = 1e6  # no outline needs to go so far beside the frame


class MaskPage(PageServer):
    """The page of one frame, served until `close`.

    Parameters
    ----------
    name : str
        Of the frame, for the person.
    frame : ndarray (H, W)
        What is drawn on.
    path : Path
        PNG that is written.
    begun : tuple of MaskedPart
        Outlines in the raw frame to go on from.
    port : int
        Where it listens on this computer; 0 takes a free one.

    Raises
    ------
    OSError
        The port is taken.
    """

    def __init__(
        self, name: str, frame: NDArray[Any], path: Path, begun: tuple[MaskedPart, ...] = (), port: int = 0
    ) -> None:
        self._name, self._shape, self._path = name, frame.shape, path
        self._shown = grey_bytes(frame)
        self._outlines = [part.outline_px for part in begun]
        super().__init__(self._show, SOCKET, PAGES, port, MAX_MESSAGE_BYTES)

    def _show(self, connection: ServerConnection) -> None:
        with suppress(ConnectionClosed, TimeoutError):
            if self.access.let_in(connection) is None:
                return
            height, width = self._shape
            words = {"name": self._name, "width": width, "height": height, "file": self._path.name}
            connection.send(json.dumps(words | {"outlines": self._outlines}))
            connection.send(self._shown)
            while True:
                connection.send(json.dumps(self._write_mask(parse_message(connection.recv()))))

    def _write_mask(self, said: dict[str, Any]) -> dict[str, Any]:
        """Write what was drawn; say what came of it."""
        outlines = outlines_of(said.get("outlines"))
        if outlines is None:
            return {"refused": f"outlines are up to {MOST_OUTLINES}, of three points or more, inside the frame"}
        left_out = np.zeros(self._shape, np.bool_)
        for outline in outlines:
            left_out |= pixels_in(MaskedPart(LEFT_OUT, outline_px=outline), self._shape)
        if not left_out.any() or left_out.all():
            return {"refused": f"this leaves out {'all' if left_out.any() else 'nothing'} of the frame"}
        done, content = cv2.imencode(".png", 255 * left_out.astype(np.uint8))
        assert done
        try:
            with whole_file(self._path) as stream:
                stream.write(content.tobytes())
        except OSError as error:
            return {"refused": f"{self._path}: {why(error)}"}
        self._outlines = outlines
        return {"saved": self._path.name, "share": float(left_out.mean())}


def outlines_of(said: object) -> list[tuple[Point, ...]] | None:
    """Outlines that a browser has sent; None if they are none."""
    if not isinstance(said, list) or not 0 < len(said) <= MOST_OUTLINES:
        return None
    outlines, points = [], 0
    for each in said:
        if not isinstance(each, list) or len(each) < 3:
            return None
        points += len(each)
        if points > MOST_POINTS:
            return None
        outline = tuple(_point(pair) for pair in each)
        if None in outline:
            return None
        outlines.append(tuple(point for point in outline if point is not None))
    return outlines


def _point(pair: object) -> Point | None:
    if not isinstance(pair, list) or len(pair) != 2 or any(type(number) not in (int, float) for number in pair):
        return None
    u, v = pair
    inside = (
        -MAX_OUTLINE_PX <= u <= MAX_OUTLINE_PX and -MAX_OUTLINE_PX <= v <= MAX_OUTLINE_PX
    )  # no number that is none, and none without end
    return (float(u), float(v)) if inside else None
