"""Page on which a person looks at vectors, and writes a file of those that he keeps.

    browser: token                       -> page: places, names, units, times, and whether there are frames
    browser: {"time": k}                 -> page: {"time": k, ...}, then float32 (fields, ny, nx), little-endian
    browser: {"frame": "a" or "b"}       -> page: {"frame": ...}, then a byte a pixel
    browser: {"check": {...}, "time": k} -> page: {"rejected": [numbers of places]}
    browser: {"write": {...}}            -> page: {"written": file, "rejected": count}
    browser: {"windows": [x, y]}         -> page: {"windows": [...]}: one place, windows of other sizes
    anything else, or what cannot be     -> page: {"refused": one sentence}

The page can write this one file, next to the one that is shown, whole or not at all; who is let in is decided as
for the live page (`daq.live.local_page`).
"""

import json
from contextlib import suppress
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection

from daq.atomic_write import why
from daq.live.local_page import PageServer, page_files, parse_message
from daq.live.picture import grey_bytes
from daq.runs.records import sentence_of
from piv.files.vector_file import Vectors, write_vectors
from rtpiv.analysis.browser.pair_frames import PairFrames
from rtpiv.analysis.browser.post_processing import Place, PostProcessing, find_outliers, post_process

SOCKET = "/vectors"
PAGES = page_files("vectors.html", "vectors.js", files("rtpiv.analysis.browser") / "page")
MAX_MESSAGE_BYTES = 4096
SUFFIX = "-checked"  # of the file that is written
_CRITERIA, _PLACE = TypeAdapter(PostProcessing), TypeAdapter[tuple[float, float]](Place)


class VectorPage(PageServer):
    """The page of one file of vectors, served until `close`.

    Parameters
    ----------
    path : Path
        The file that is shown.
    vectors : Vectors
        Its content.
    frames : PairFrames or str
        Corrected frames of the pair, or why there are none.
    port : int
        Port on this computer; 0 for any free one.

    Raises
    ------
    OSError
        The port is taken.
    """

    def __init__(self, path: Path, vectors: Vectors, frames: PairFrames | str, port: int = 0) -> None:
        self._path, self._vectors, self._frames = path, vectors, frames
        shape = (len(vectors.times), len(vectors.y_mm), len(vectors.x_mm))
        self._names = [name for name, values in vectors.fields.items() if values.shape == shape]
        super().__init__(self._show, SOCKET, PAGES, port, MAX_MESSAGE_BYTES)

    def _show(self, connection: ServerConnection) -> None:
        with suppress(ConnectionClosed, TimeoutError):
            if self.access.let_in(connection) is None:
                return
            connection.send(json.dumps(self._about()))
            while True:
                words, content = self._reply(parse_message(connection.recv()))
                connection.send(json.dumps(words))
                if content is not None:
                    connection.send(content)

    def _about(self) -> dict[str, Any]:
        """Return what the file holds, and where its places and the pixels of its frames lie."""
        vectors, frames = self._vectors, self._frames
        about: dict[str, Any] = {
            "file": self._path.name,
            "folder": self._path.resolve().parent.name,
            "writes": output_of(self._path).name,
            "x": vectors.x_mm.tolist(),
            "y": vectors.y_mm.tolist(),
            "length": vectors.length_unit,
            "names": self._names,
            "units": dict(vectors.units),
            "kind": vectors.kind,
            "times": len(vectors.times),
            "flags": str(vectors.attributes.get("flag_meanings", "")),
        }
        if isinstance(frames, str):
            return about | {"no_frames": frames}
        grid = frames.grid
        return about | {
            "frame": {
                "x0": grid.origin_mm[0],
                "y0": grid.origin_mm[1],
                "pitch": grid.pitch_mm,
                "width": grid.shape[1],
                "height": grid.shape[0],
            },
        }

    def _reply(self, asked: dict[str, Any]) -> tuple[dict[str, Any], bytes | None]:
        """Answer one message: words, and bytes that follow them."""
        time = asked.get("time", 0)
        if type(time) is not int or not 0 <= time < len(self._vectors.times):
            return {"refused": f"the file holds {len(self._vectors.times)} times, numbered from 0"}, None
        if "check" in asked or "write" in asked:
            try:
                chosen = _CRITERIA.validate_python(asked.get("check", asked.get("write")))
            except ValidationError as error:
                return {"refused": sentence_of(error)}, None
            return self._check(time, chosen) if "check" in asked else self._write(chosen), None
        if "windows" in asked:
            return self._other_windows(asked["windows"]), None
        if asked.get("frame") in ("a", "b") and not isinstance(self._frames, str):
            return {"frame": asked["frame"]}, grey_bytes(getattr(self._frames, asked["frame"]))
        if "time" in asked:
            stacked = np.stack([self._vectors.fields[name][time].astype("<f4") for name in self._names])
            return {"time": time, "tag": self._tag(time)}, stacked.tobytes()
        return {"refused": "the page does not know this request"}, None

    def _tag(self, time: int) -> str:
        """Return the name of the pair of one time; empty for a mean."""
        with suppress(ValueError, KeyError, IndexError, TypeError):
            return str(json.loads(self._vectors.attributes["pairs"])[time])
        return ""

    def _check(self, time: int, chosen: PostProcessing) -> dict[str, Any]:
        rejected = find_outliers(self._vectors, time, chosen)
        measured = int(self._vectors.measured[time].sum())
        return {"rejected": np.flatnonzero(rejected).tolist(), "measured": measured}

    def _write(self, chosen: PostProcessing) -> dict[str, Any]:
        """Write the vectors that are kept; say how many were not."""
        processed = post_process(self._vectors, chosen)
        try:
            write_vectors(output_of(self._path), processed)
        except OSError as error:
            return {"refused": f"{output_of(self._path)}: {why(error)}"}
        rejected = sum(
            int(find_outliers(self._vectors, time, chosen).sum()) for time in range(len(self._vectors.times))
        )
        return {"written": output_of(self._path).name, "rejected": rejected}

    def _other_windows(self, place: object) -> dict[str, Any]:
        if isinstance(self._frames, str):
            return {"refused": self._frames}
        x_mm, y_mm = self._vectors.x_mm, self._vectors.y_mm
        with suppress(ValidationError):
            x, y = _PLACE.validate_python(place)
            if x_mm[0] <= x <= x_mm[-1] and y_mm[0] <= y <= y_mm[-1]:
                return {"windows": list(self._frames.vectors_at(x, y)), "place": (x, y)}
        return {"refused": "choose a place among the vectors"}


def output_of(path: Path) -> Path:
    """Return the file that the page of a file of vectors writes."""
    return path.with_name(f"{path.stem}{SUFFIX}.nc")
