"""Run a GigE Vision device in a process of its own: ``python -m sim.camera.gige ADDRESS CONFIG_JSON``.

Prints one line when it listens, and ends with its standard input: a device never outlives the bench that started
it.
"""

import sys

from sim.camera.config import CameraConfig
from sim.camera.gige.device import GigeDevice


def main() -> None:
    """Serve until standard input ends."""
    address, config = sys.argv[1], CameraConfig.from_json(sys.argv[2])
    with GigeDevice(config, address):
        sys.stdout.write(f"listening on {address}\n")
        sys.stdout.flush()
        sys.stdin.read()


if __name__ == "__main__":
    main()
