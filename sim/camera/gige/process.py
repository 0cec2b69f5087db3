"""A GigE Vision device in a process of its own: a real camera does not share its client's processor time."""

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count

from daq.child import child
from sim.camera.config import CameraConfig

PATIENCE_S = 10.0
_hosts = count(1)


def loopback_address() -> str:
    """An address of this machine that no other process of ours uses; the port is fixed by the standard."""
    number = os.getpid()
    return f"127.{20 + number % 200}.{1 + number // 200 % 250}.{next(_hosts)}"


@contextmanager
def device_process(config: CameraConfig) -> Iterator[str]:
    """Serve a camera on the loopback while the block runs; yield its address.

    Raises
    ------
    OSError
        The process ended before it served; what it wrote to stderr says why.
    """
    address = loopback_address()
    command, environment = child("sim.camera.gige", address, config.to_json())
    device = subprocess.Popen(command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        assert device.stdin is not None
        assert device.stdout is not None
        if not device.stdout.readline():
            raise OSError(f"no camera could be put up on {address}")
        yield address
    finally:
        device.communicate(timeout=PATIENCE_S)  # it ends with its standard input
