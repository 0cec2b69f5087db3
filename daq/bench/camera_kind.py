"""A camera behind one of the backends."""

from collections.abc import Iterator
from contextlib import contextmanager

from daq.bench.bench_table import Bench, CameraSection, NamedCameraSection
from daq.cameras import make_camera
from daq.cameras.camera import Camera
from daq.cameras.double_height import DoubleHeightCamera
from stages.clock import Clock


class CameraKind:
    """The section `camera`, and every further camera under `devices`."""

    section = NamedCameraSection
    simulator = None  # its eyes are the world's

    @contextmanager
    def open(self, section: CameraSection, bench: Bench, clock: Clock) -> Iterator[Camera]:
        """Open it, not yet configured."""
        camera = make_camera(section.backend, **section.options)
        if section.pairs is not None and section.pairs.shape == "double_height":
            camera = DoubleHeightCamera(camera)
        try:
            camera.open()
            yield camera
        finally:
            camera.close()

    def places(self, section: CameraSection) -> Iterator[str]:
        """Producer or address."""
        options = section.options
        named = (("cti", "GenTL producer"), ("address", "GigE Vision at"), ("device_id", "USB3 Vision"))
        where = [f"{words} {options[key]}" for key, words in named if key in options]
        where += [f"{section.backend} {' '.join(str(value) for value in options.values())}"]
        yield f"camera: {where[0]}"
