"""Pairs of (backend, device) that the contract tests run on.

A rig builds a closed camera for a simulated-camera configuration, and knows how to take everything down again.
"""

import importlib.util
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import pytest

from daq.camera import Camera
from sim.camera.config import CameraConfig

Make = Callable[[CameraConfig], Camera]


@contextmanager
def harvesters_on_simulated_producer(folder: Path) -> Iterator[Make]:
    if importlib.util.find_spec("harvesters") is None:
        pytest.skip("harvesters is not installed (extra rtpiv[camera])")
    from daq.cameras.harvesters import HarvestersCamera
    from sim.camera.gentl import write_producer

    made: list[Camera] = []

    def make(config: CameraConfig) -> Camera:
        path = write_producer(folder / f"sim{len(made)}.cti", [config])
        made.append(HarvestersCamera(path, config.serial))
        return made[-1]

    yield make
    for camera in made:
        camera.close()


RIGS: dict[str, Callable[[Path], AbstractContextManager[Make]]] = {
    "harvesters-simulated": harvesters_on_simulated_producer,
}
