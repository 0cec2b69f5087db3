"""A GigE Vision device in a process of its own: a real camera does not share its client's processor time.

    python -m sim.camera.gige.process ADDRESS CONFIG_JSON

The process prints one line when it listens, and ends with its standard input: a device never outlives the bench
that started it.
"""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count

from daq.child import child
from sim.camera.config import CameraConfig
from sim.camera.gige.device import GigeDevice

END_PATIENCE_S = 10.0
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
    command, environment = child("sim.camera.gige.process", address, config.to_json())
    device = subprocess.Popen(command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        assert device.stdin is not None
        assert device.stdout is not None
        if not device.stdout.readline():
            raise OSError(f"no camera could be started on {address}")
        yield address
    finally:
        device.communicate(timeout=END_PATIENCE_S)  # it ends with its standard input


def main() -> None:
    """Serve until standard input ends."""
    address, config = sys.argv[1], CameraConfig.from_json(sys.argv[2])
    with GigeDevice(config, address):
        sys.stdout.write(f"listening on {address}\n")
        sys.stdout.flush()
        sys.stdin.read()


if __name__ == "__main__":
    main()
