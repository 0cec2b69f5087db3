"""Sources of the pixels of a simulated camera.

A source is asked once per exposure for the whole sensor; the camera crops, applies the gain and packs.  Sources
are named by "package.module:factory" with JSON arguments, because the camera may live in another process.
"""

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, cast, runtime_checkable

import numpy as np
from numpy.typing import NDArray


class FrameSource(Protocol):
    """Source of sensor images."""

    def frame(self, trigger_index: int, time_ns: int) -> NDArray[np.uint16]:
        """Return the sensor's image of one exposure.

        Parameters
        ----------
        trigger_index : int
            Accepted triggers since power-up, 0 for the first; both images of a double-frame share it.
        time_ns : int
            Start of the exposure on the host's monotonic clock.

        Returns
        -------
        (H, W) uint16
            Grey values in the sensor's bits.  An array that is not writeable is taken as constant and packed
            only once.
        """


@runtime_checkable
class LitSource(Protocol):
    """A source that needs to know how long the shutter was open, because light comes in pulses."""

    def expose(self, trigger_index: int, start_ns: int, end_ns: int) -> NDArray[np.uint16]:
        """Return the sensor's image of one exposure, as `FrameSource.frame` does.

        Parameters
        ----------
        trigger_index : int
            As there.
        start_ns, end_ns : int
            Of the exposure, on the host's monotonic clock.
        """


def image_of(source: FrameSource, trigger_index: int, start_ns: int, end_ns: int) -> NDArray[np.uint16]:
    """One exposure of a source that may want to know its end."""
    if isinstance(source, LitSource):
        return source.expose(trigger_index, start_ns, end_ns)
    return source.frame(trigger_index, start_ns)


class PatternSource:
    """A slanted ramp that says which trigger it belongs to, different in every pixel bit.

    Parameters
    ----------
    width, height : int
        Sensor size [px].
    bits : int
        Significant bits.
    """

    def __init__(self, width: int, height: int, bits: int = 12) -> None:
        row, col = np.indices((height, width), dtype=np.uint32)
        self._ramp = 3 * col + 5 * row + 7 * ((row * col) >> 4)
        self._mask = np.uint32((1 << bits) - 1)

    def frame(self, trigger_index: int, time_ns: int) -> NDArray[np.uint16]:
        """Ramp shifted by 17 grey values a trigger; pixel (0, 0) holds the trigger index."""
        image = ((self._ramp + np.uint32(17 * trigger_index % 65521)) & self._mask).astype(np.uint16)
        image[0, 0] = trigger_index & int(self._mask)
        return image


class RingSource:
    """Replay frames that were rendered before, so that the camera itself costs nothing.

    Parameters
    ----------
    folder : path
        Folder with one `.npy` file (H, W) uint16 a frame, shown in the order of their names, again and again.
    first : int
        Frames shown in an earlier life.
    """

    def __init__(self, folder: Path | str, first: int = 0) -> None:
        paths = sorted(Path(folder).glob("*.npy"))
        if not paths:
            raise ValueError(f"{folder} holds no .npy frames; write some with numpy.save")
        self._frames = [np.ascontiguousarray(np.load(path, allow_pickle=False), np.uint16) for path in paths]
        for frame in self._frames:
            frame.flags.writeable = False
        self._shown = first

    def frame(self, trigger_index: int, time_ns: int) -> NDArray[np.uint16]:
        """Return the next frame of the ring, exposure by exposure."""
        frame = self._frames[self._shown % len(self._frames)]
        self._shown += 1
        return frame


def load_named(dotted: str) -> Any:  # noqa: ANN401 - whatever a module holds
    """Import what a configuration names as "package.module:name".

    Raises
    ------
    ValueError
        The name has no colon.
    ImportError, AttributeError
        There is no such module, or no such name in it.
    """
    module_name, colon, name = dotted.partition(":")
    if not colon:
        raise ValueError(f"{dotted!r} must be written as package.module:name")
    return getattr(import_module(module_name), name)


def load_source(dotted: str, arguments: Mapping[str, Any]) -> FrameSource:
    """Make the frame source of a factory that a configuration names, see `load_named`."""
    return cast("FrameSource", load_named(dotted)(**arguments))
