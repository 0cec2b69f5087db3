"""One register of a GigE camera, read over a socket of our own with a deadline.

libaravis repeats a request for seconds before it reports a loss.  Any GigE Vision device lets other applications
read while one is in control, so a single read tells quickly whether the camera answers, and its control register
whether it still knows that it is controlled: a camera that was restarted does not.

Source: AIA, GigE Vision specification 1.2, READREG and the control channel privilege register.
"""

import os
import socket
import struct
import time

from daq.errors import CameraLost

PORT = 3956
CONTROL_PRIVILEGE = 0x0A00
READ_REGISTER, READ_REGISTER_ANSWER = 0x0080, 0x0081
REQUEST_ATTEMPTS = 3


def read_register(address: str, register: int, timeout_s: float) -> int:
    """Read a 32 bit register.

    Parameters
    ----------
    address : str
        IPv4 address of the camera.
    register : int
        Register address.
    timeout_s : float
        Time for all tries together [s].

    Raises
    ------
    CameraLost
        If no valid answer came in time.
    """
    number = int.from_bytes(os.urandom(2), "big") or 1
    request = struct.pack(">BBHHHI", 0x42, 1, READ_REGISTER, 4, number, register)
    end = time.monotonic() + timeout_s
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as channel:
        channel.connect((address, PORT))
        for attempt in range(REQUEST_ATTEMPTS):
            try:
                channel.send(request)
                deadline = end - timeout_s * (REQUEST_ATTEMPTS - 1 - attempt) / REQUEST_ATTEMPTS
                while (left_s := deadline - time.monotonic()) > 0:
                    channel.settimeout(left_s)
                    value = _value(channel.recv(64), number)
                    if value is not None:
                        return value
            except TimeoutError:
                continue
            except OSError as error:
                raise CameraLost(
                    f"no camera at {address}: {error.strerror}; check address, cable, power"
                ) from error
    raise CameraLost(f"the camera at {address} gave no answer within {timeout_s:g} s; check cable and power")


def is_controlled(address: str, timeout_s: float) -> bool:
    """Return whether the camera believes that some application controls it."""
    return bool(read_register(address, CONTROL_PRIVILEGE, timeout_s) & 3)


def local_address(address: str) -> str:
    """Address of the interface of this machine from which the camera is reached; sends nothing.

    Raises
    ------
    CameraLost
        This machine has no way to the address, or it is none; look at the network settings.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as channel:
        try:
            channel.connect((address, PORT))
        except OSError as error:
            raise CameraLost(f"{address} cannot be reached from this machine: {error.strerror}") from error
        return str(channel.getsockname()[0])


def _value(datagram: bytes, number: int) -> int | None:
    """Value in an answer to request `number`; None for anything else."""
    if len(datagram) != 12:
        return None
    status, command, length, answered, value = struct.unpack(">HHHHI", datagram)
    is_ours = (command, length, answered) == (READ_REGISTER_ANSWER, 4, number)
    return int(value) if is_ours and status == 0 else None
