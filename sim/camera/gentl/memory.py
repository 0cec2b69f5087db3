"""Reading from and writing to the caller's memory, with the GenTL rules for sizes.

Every answer may be asked for twice: with a null buffer for its size, then with a buffer of that size.
"""

import ctypes

from sim.camera.gentl.abi import SIZES, Answer, GenTLError, Kind, Status


def read_text(pointer: int) -> str:
    """A zero-terminated string of the caller.

    Raises
    ------
    GenTLError
        INVALID_PARAMETER: the pointer is null.
    """
    if not pointer:
        raise GenTLError(Status.INVALID_PARAMETER, "null pointer instead of a string")
    return ctypes.string_at(pointer).decode("utf-8", "replace")


def read_size(pointer: int) -> int:
    """A size_t of the caller.

    Raises
    ------
    GenTLError
        INVALID_PARAMETER: the pointer is null.
    """
    if not pointer:
        raise GenTLError(Status.INVALID_PARAMETER, "null pointer instead of a size")
    return ctypes.c_size_t.from_address(pointer).value


def write_size(pointer: int, value: int) -> None:
    """Write a size_t, a handle or a pointer.

    Raises
    ------
    GenTLError
        INVALID_PARAMETER: the pointer is null.
    """
    if not pointer:
        raise GenTLError(Status.INVALID_PARAMETER, "null pointer for a result")
    ctypes.c_size_t.from_address(pointer).value = value


def write_u32(pointer: int, value: int) -> None:
    """Write a uint32_t.

    Raises
    ------
    GenTLError
        INVALID_PARAMETER: the pointer is null.
    """
    if not pointer:
        raise GenTLError(Status.INVALID_PARAMETER, "null pointer for a result")
    ctypes.c_uint32.from_address(pointer).value = value


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

    Raises
    ------
    GenTLError
        INVALID_PARAMETER: the address is null.
    """
    if not address:
        raise GenTLError(Status.INVALID_PARAMETER, "null pointer for a result")
    if data:
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
