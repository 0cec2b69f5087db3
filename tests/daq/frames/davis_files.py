"""Images of DaVis to read: written by LaVision's own lvpyio where that is installed, or for a stand-in of it.

The stand-in has of lvpyio what is called of it; it shows that this program asks rightly, and nothing of LaVision's
format.
"""

from pathlib import Path
from types import SimpleNamespace

import numpy as np

WRITTEN = {"_Date": "27.11.26"}  # what DaVis writes behind the pixels


def frame_of(pixels, kind="ImageFrame", scale=(1.0, 0.0), mask=None, **attributes):
    intensity = SimpleNamespace(slope=scale[0], offset=scale[1])
    return SimpleNamespace(
        images=[pixels],
        masks=[np.ones(pixels.shape, np.uint8) if mask is None else mask],
        type_id=kind,
        scales=SimpleNamespace(i=intensity),
        attributes=attributes,
    )


class Buffer:
    def __init__(self, frames, attributes):
        self.frames, self.attributes = frames, attributes

    def __len__(self):
        return len(self.frames)

    def __getitem__(self, index):
        return self.frames[index]


class StandIn:
    """A module like lvpyio; what was written stays here, and its files hold their own names."""

    def __init__(self):
        self.written = {}

    def read_buffer(self, path):
        if path not in self.written or Path(path).read_bytes() != path.encode():
            raise RuntimeError("Invalid header.")
        return self.written[path]

    def read_set(self, path):
        folder = Path(path).with_suffix("")
        try:
            names = Path(path).read_text().split()
        except UnicodeDecodeError:
            raise RuntimeError("Invalid set.") from None
        return Set(self, [str(folder / name) for name in names])

    def is_multiset(self, path):
        return False

    def write_buffer(self, frames, path, attributes=WRITTEN):
        frames = [each if isinstance(each, SimpleNamespace) else frame_of(each) for each in frames]
        Path(path).write_bytes(str(path).encode())
        self.written[str(path)] = Buffer(frames, dict(attributes))

    def write_set(self, buffers, path):
        folder = Path(path).with_suffix("")
        folder.mkdir()
        names = [f"B{number:05d}.im7" for number in range(1, len(buffers) + 1)]
        for name, frames in zip(names, buffers, strict=True):
            self.write_buffer(frames, folder / name)
        Path(path).write_text("\n".join(names))


class Set:
    """A set that reads an image when it is asked for it."""

    def __init__(self, library, paths):
        self._library, self._paths = library, paths

    def __len__(self):
        return len(self._paths)

    def __getitem__(self, index):
        return self._library.read_buffer(self._paths[index])
