"""Adapters to the genicam package: a GenApi node map as `cameras.sfnc.Nodes`, facts of a GenTL buffer.

Nearly every answer of a buffer is optional in the standard, so each has a default that does no harm, or a frame is
refused with a reason.  Frames of several parts or with chunks before the image give no plain size here and are
refused.
"""

import math
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from genicam import genapi, gentl
from numpy.typing import NDArray

from daq.cameras.camera import Setting
from daq.cameras.formats import PixelFormat, pixel_format
from daq.cameras.sfnc import Nodes
from daq.errors import BadFrame, SettingRefused


class GenApiNodes:
    """A node map as `Nodes`."""

    def __init__(self, node_map: Any) -> None:  # noqa: ANN401 - genicam has no types
        self._map = node_map

    def names(self) -> list[str]:
        """Every feature below Root that has a value."""
        with_value = {genapi.EInterfaceType.intfIInteger, genapi.EInterfaceType.intfIFloat}
        with_value |= {genapi.EInterfaceType.intfIBoolean, genapi.EInterfaceType.intfIString}
        with_value.add(genapi.EInterfaceType.intfIEnumeration)
        return [
            entry.node.name
            for entry in self._map.nodes
            if entry.node.is_feature() and entry.node.principal_interface_type in with_value
        ]

    def has(self, name: str) -> bool:
        """Return whether the feature exists and can be read or written now."""
        if not self._map.has_node(name):
            return False
        return self._map.get_node(name).get_access_mode() in (genapi.EAccessMode.RO, genapi.EAccessMode.RW)

    def get(self, name: str) -> Setting:
        """Value of a feature, past the cache."""
        feature = self._map.get_node(name)
        for node in (feature.node, *(child.node for child in feature.node.children)):
            node.invalidate_node()
        if not hasattr(feature, "value"):
            raise SettingRefused(f"{name} has no value; it is a command or a category")
        value = feature.value
        return value if isinstance(value, bool | int | float | str) else str(value)

    def set(self, name: str, value: Setting) -> None:
        """Write a feature; SettingRefused with the limits if it does not take the value."""
        feature = self._map.get_node(name)
        try:
            feature.value = value
        except (genapi.GenericException, TypeError, OverflowError) as error:
            raise SettingRefused(
                f"{name} = {value!r} is refused{self._limits(feature)}: {one_line(error)}"
            ) from error

    def entries(self, name: str) -> tuple[str, ...]:
        """Entries of an enumeration."""
        return tuple(self._map.get_node(name).symbolics)

    def can_execute(self, name: str) -> bool:
        """Return whether the command exists and is available now."""
        if not self._map.has_node(name):
            return False
        return self._map.get_node(name).get_access_mode() in (genapi.EAccessMode.WO, genapi.EAccessMode.RW)

    def execute(self, name: str) -> None:
        """Execute a command."""
        self._map.get_node(name).execute()

    def _limits(self, feature: Any) -> str:  # noqa: ANN401
        try:
            if hasattr(feature, "symbolics"):
                return f" (one of {', '.join(feature.symbolics)})"
            return f" (from {feature.min} to {feature.max})"
        except (AttributeError, genapi.GenericException):
            return ""


def one_line(error: BaseException) -> str:
    """Text of an error of the library, which likes several lines."""
    return " ".join(str(error).split())[:300] or type(error).__name__


BIG_ENDIAN = 2  # PIXELENDIANNESS_BIG


@dataclass(frozen=True, slots=True)
class BufferFacts:
    """One filled buffer.

    Parameters
    ----------
    form : PixelFormat
        Format on the wire.
    width, height : int
        Size of the image [px].
    padding_bytes : int
        Bytes after each row that belong to no pixel.
    payload : (N,) uint8
        Its bytes from the image on, in the producer's memory; multi-byte pixels little-endian.
    """

    form: PixelFormat
    width: int
    height: int
    padding_bytes: int
    payload: NDArray[np.uint8]


def image_of(buffer: Any) -> BufferFacts:  # noqa: ANN401 - genicam has no types
    """Return what is needed to unpack a buffer.

    Raises
    ------
    BadFrame
        It does not tell format and size of one image, or in a form that is not supported.
    """
    code, width, height = (_first_answer(buffer, name) for name in ("pixel_format", "width", "height"))
    if code is None or width is None or height is None:
        kind = _first_answer(buffer, "payload_type")
        raise BadFrame(
            f"the camera sends frames that are no single image (payload type {kind}); switch off chunk data, "
            "GenDC and multi-part frames (ChunkModeActive, GenDCStreamingMode)"
        )
    form = pixel_format(code)
    first = _first_answer(buffer, "image_offset") or 0
    size = _first_answer(buffer, "data_size", "size_filled", "size") or 0
    payload = np.frombuffer(buffer.raw_buffer, np.uint8)[first:size]
    if form.wire_bits == 16 and _first_answer(buffer, "pixel_endianness") == BIG_ENDIAN:
        payload = payload[: payload.size // 2 * 2].view(np.uint16).byteswap().view(np.uint8)
    return BufferFacts(form, width, height, _first_answer(buffer, "padding_x") or 0, payload)


def frame_id(buffer: Any) -> int | None:  # noqa: ANN401
    """Id as the camera gave it; None if the producer does not tell."""
    return _first_answer(buffer, "frame_id")


def timestamp_ns(buffer: Any) -> int:  # noqa: ANN401
    """Camera clock; 0 if it has none, or one of unknown ticks."""
    found = _first_answer(buffer, "timestamp_ns")
    if found is not None:
        return found
    ticks, per_s = _first_answer(buffer, "timestamp"), _first_answer(buffer.parent.parent, "timestamp_frequency")
    return round(ticks * 1e9 / per_s) if ticks and per_s else 0


def chunks_of(buffer: Any, nodes: Nodes, names: Iterable[str]) -> dict[str, float]:  # noqa: ANN401
    """Chunk data that came with a frame, by SFNC name.

    The node map keeps the chunks of an earlier buffer where this one has none, so the buffer is asked first.
    Harvesters has attached this buffer to the node map when it was fetched.
    """
    names = tuple(names)
    if not names or not _has_chunks(buffer):
        return {}
    found: dict[str, float] = {}
    for name in names:
        with suppress(genapi.GenericException, gentl.GenericException):  # not among those of this frame
            value = nodes.get(f"Chunk{name}")
            found[name] = value if isinstance(value, float) else int(value)
    return {name: value for name, value in found.items() if math.isfinite(value)}


def _has_chunks(buffer: Any) -> bool:  # noqa: ANN401
    try:
        return bool(buffer.is_containing_chunk_data())
    except gentl.GenericException:  # a producer before GenTL 1.5
        return bool(_first_answer(buffer, "num_chunks"))


def _first_answer(module: Any, *names: str) -> int | None:  # noqa: ANN401
    """First answer that is available."""
    for name in names:
        try:
            return int(getattr(module, name))
        except gentl.GenericException:
            continue
    return None
