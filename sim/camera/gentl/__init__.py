"""The simulated camera as a GenTL producer: a .cti file that any Python process can load.

`write_producer` makes the file; Harvesters, or any other GenTL consumer inside CPython, does the rest.
"""

import json
import os
from collections.abc import Sequence
from pathlib import Path

from sim.camera.config import CameraConfig
from sim.camera.gentl.abi import SIGNATURES
from sim.camera.gentl.elf import build


def write_producer(path: Path | str, configs: Sequence[CameraConfig]) -> Path:
    """Write a producer with the given cameras.

    Parameters
    ----------
    path : path
        File to write; its name should end in .cti.
    configs : sequence of CameraConfig
        Cameras on its one interface, each with a serial number of its own.

    Returns
    -------
    Path
        Absolute path of the file.

    Raises
    ------
    ValueError
        Two cameras have the same serial number.
    """
    path = Path(path).resolve()
    if len({config.serial for config in configs}) != len(configs):
        raise ValueError("every simulated camera needs a serial number of its own")
    cameras = json.dumps([json.loads(config.to_json()) for config in configs])
    script = f"from sim.camera.gentl.producer import attach\nattach({str(path)!r}, {cameras!r})\n"
    temporary = path.with_suffix(f".{os.getpid()}.tmp")
    temporary.write_bytes(build(tuple(SIGNATURES), script))
    temporary.replace(path)
    return path
