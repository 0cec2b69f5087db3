"""Reading from and writing to the caller's memory, with the GenTL rules for sizes.

Every answer may be asked for twice: with a null buffer for its size, then with a buffer of that size.
"""

import ctypes

from sim.camera.gentl.abi import SIZES, Answer, GenTLError, Kind, Status


def _address(pointer: int, what: str) -> int:
    """Return a pointer that is not null.

    Raises
    ------
    GenTLError
        INVALID_PARAMETER: it is null.
    """
    if not pointer:
        raise GenTLError(Status.INVALID_PARAMETER, f"null pointer {what}")
    return pointer


def read_text(pointer: int) -> str:
    """Return a zero-terminated string of the caller."""
    return ctypes.string_at(_address(pointer, "instead of a string")).decode("utf-8", "replace")


def read_size(pointer: int) -> int:
    """Return a size_t of the caller."""
    return ctypes.c_size_t.from_address(_address(pointer, "instead of a size")).value


def write_size(pointer: int, value: int) -> None:
    """Write a size_t, a handle or a pointer."""
    ctypes.c_size_t.from_address(_address(pointer, "for a result")).value = value


def write_u32(pointer: int, value: int) -> None:
    """Write a uint32_t."""
    ctypes.c_uint32.from_address(_address(pointer, "for a result")).value = value


def write_bool(pointer: int, value: bool) -> None:
    """Write a bool8_t; a null pointer means that it is not asked for."""
    if pointer:
        ctypes.c_uint8.from_address(pointer).value = int(value)


def give(data: bytes, buffer: int, size: int) -> None:
    """Hand out `data`: its size alone for a null buffer, else the bytes if they fit.

    Raises
    ------
    GenTLError
        BUFFER_TOO_SMALL: they do not fit; INVALID_PARAMETER: the pointer to the size is null.
    """
    room = read_size(size)
    write_size(size, len(data))
    if not buffer:
        return
    if room < len(data):
        raise GenTLError(Status.BUFFER_TOO_SMALL, f"{len(data)} bytes do not fit into {room}")
    put(data, buffer)


def put(data: bytes, address: int) -> None:
    """Copy bytes to the caller without letting go of Python's lock, as ctypes.memmove would.

    A client may hold a lock of its own (GenApi's node map) around this call; another thread of it that gets
    Python's lock now and then waits for that one would never let us go on.
    """
    if _address(address, "for a result") and data:
        memoryview((ctypes.c_char * len(data)).from_address(address)).cast("B")[:] = data


def give_text(text: str, buffer: int, size: int) -> None:
    """Hand out a zero-terminated string."""
    give(text.encode() + b"\0", buffer, size)


def give_answer(answer: Answer, kind: int, buffer: int, size: int) -> None:
    """Hand out a typed answer of an Info function."""
    datatype, value = answer
    if kind:
        ctypes.c_int32.from_address(kind).value = int(datatype)
    if datatype is Kind.STRING:
        give_text(str(value), buffer, size)
        return
    give(int(value).to_bytes(SIZES[datatype], "little", signed=int(value) < 0), buffer, size)
