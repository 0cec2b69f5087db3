"""Whether frames are what the camera was set to: a producer may read one pixel format back and send another.

Pixels of another format are other grey values, and those of another size another place, so not even the first
such frame may be kept.  Compared is what the camera read back with what each frame itself announces; both are
known already, so it costs nothing.
"""

from collections.abc import Mapping

from daq.cameras.camera import Setting
from daq.cameras.formats import FORMATS
from daq.cameras.frame import Frame


class FrameFormat:
    """Pixel format and size that frames must have.

    Parameters
    ----------
    settings : mapping
        What the camera read back; what it does not tell is not compared.
    """

    def __init__(self, settings: Mapping[str, Setting]) -> None:
        name = settings.get("PixelFormat")
        self._name = name if name in FORMATS else None  # a name of the vendor's own says nothing
        self._sides = [settings.get(side) for side in ("Width", "Height")]

    def contradiction(self, frame: Frame) -> str:
        """How a frame differs from what was read back, as the rest of a sentence; "" if it does not."""
        height, width = frame.pixels.shape
        got = (frame.meta.pixel_format, width, height)
        told = (self._name, *self._sides)
        if all(mine is None or mine == its for mine, its in zip(told, got, strict=True)):
            return ""
        said = [str(mine if mine is not None else its) for mine, its in zip(told, got, strict=True)]
        return (
            f"sends {got[0]} of {width} x {height} px and reads {said[0]} of {said[1]} x {said[2]} px back; "
            "set PixelFormat, Width and Height to what it really sends"
        )
