"""Pairs of (backend, device) that the contract tests run on.

A rig makes a closed camera for a simulated-camera configuration, a second one for the same device, and takes
everything down again.
"""

import ctypes
import importlib.util
from pathlib import Path

import pytest

from daq.cameras.camera import Camera
from sim.camera.config import CameraConfig
from sim.camera.device import SimCamera
from sim.camera.gentl import write_producer
from sim.camera.gige import GigeDevice
from sim.camera.gige.process import loopback_address
from sim.camera.in_process import DEVICES, InProcessCamera


def need_harvesters():
    if importlib.util.find_spec("harvesters") is None or importlib.util.find_spec("genicam") is None:
        pytest.skip("harvesters or genicam is not installed (extra rtpiv[camera])")


def need_aravis():
    try:
        ctypes.CDLL("libaravis-0.8.so.0")
    except OSError:
        pytest.skip("libaravis-0.8.so.0 is not installed (apt-get install libaravis-0.8-0)")


class HarvestersRig:
    def __init__(self, folder: Path) -> None:
        need_harvesters()
        self._folder = folder
        self._made: list[Camera] = []

    def make(self, config: CameraConfig) -> Camera:
        return self._camera(write_producer(self._folder / f"sim{len(self._made)}.cti", [config]))

    def again(self, camera: Camera) -> Camera:
        return self._camera(camera.info.address)

    def close(self) -> None:
        for camera in self._made:
            camera.close()

    def _camera(self, path: Path | str) -> Camera:
        from daq.cameras.harvesters import HarvestersCamera

        self._made.append(HarvestersCamera(path))
        return self._made[-1]


class AravisRig:
    def __init__(self, folder: Path) -> None:
        need_aravis()
        self._devices: list[GigeDevice] = []
        self._made: list[Camera] = []

    def make(self, config: CameraConfig) -> Camera:
        self._devices.append(GigeDevice(config, loopback_address()))
        return self._camera(self._devices[-1].address)

    def again(self, camera: Camera) -> Camera:
        return self._camera(camera.info.address)

    def close(self) -> None:
        for camera in self._made:
            camera.close()
        for device in self._devices:
            device.close()

    def _camera(self, address: str) -> Camera:
        from daq.cameras.aravis import AravisCamera

        self._made.append(AravisCamera(address))
        return self._made[-1]


class InProcessRig:
    def __init__(self, folder: Path) -> None:
        self._prefix = folder.name
        self._made: list[InProcessCamera] = []
        self._names: list[str] = []

    def make(self, config: CameraConfig) -> Camera:
        self._names.append(f"{self._prefix}-{len(self._names)}")
        DEVICES[self._names[-1]] = SimCamera(config)
        return self._camera(self._names[-1])

    def again(self, camera: Camera) -> Camera:
        return self._camera(camera.info.address)

    def close(self) -> None:
        for camera in self._made:
            camera.close()
        for name in self._names:
            DEVICES.pop(name).power_off()

    def _camera(self, name: str) -> Camera:
        self._made.append(InProcessCamera(name))
        return self._made[-1]


RIGS = {"harvesters": HarvestersRig, "aravis": AravisRig, "memory": InProcessRig}
