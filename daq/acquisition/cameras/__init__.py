"""Camera backends: one file each, one line here.

A bench file names a backend (`harvesters`, `aravis`, `micromanager`, `files`) or, for a camera outside this
project, a dotted "package.module:Class".  A backend is imported only when it is asked for, so nobody needs
libraries for cameras that stand elsewhere.
"""

from importlib import import_module
from importlib.util import find_spec
from typing import Any, cast

from daq.acquisition.cameras.camera import Camera
from daq.errors import CameraSetupError

BACKENDS = {
    "harvesters": "daq.acquisition.cameras.harvesters:HarvestersCamera",
    "aravis": "daq.acquisition.cameras.aravis:AravisCamera",
    "micromanager": "daq.acquisition.cameras.micromanager:MicroManagerCamera",
    "files": "daq.acquisition.cameras.files:FilesCamera",
}
LIBRARIES = {"harvesters": ("harvesters", "genicam")}  # of the extra rtpiv[camera]


def require_libraries(backend: str) -> None:
    """Look whether a backend's libraries are installed, before anybody waits for anything.

    Raises
    ------
    CameraSetupError
        Some are not; the message names them and the extra that brings them.
    """
    missing = [name for name in LIBRARIES.get(backend, ()) if find_spec(name) is None]
    if missing:
        raise CameraSetupError(
            f"camera backend {backend!r} needs {' and '.join(missing)}; install the extra rtpiv[camera]"
        )


def make_camera(backend: str, **options: Any) -> Camera:  # noqa: ANN401 - each backend checks its own options
    """Return a closed camera of the named backend.

    Raises
    ------
    CameraSetupError
        If the backend is unknown or does not take these options.
    """
    dotted = BACKENDS.get(backend, backend)
    module_name, colon, class_name = dotted.partition(":")
    if not colon:
        raise CameraSetupError(f"camera backend {backend!r} is unknown; use one of {', '.join(BACKENDS)}")
    try:
        make = getattr(import_module(module_name), class_name)
    except (ImportError, AttributeError) as error:
        raise CameraSetupError(f"camera backend {backend!r} cannot be loaded: {error}") from error
    try:
        return cast("Camera", make(**options))
    except TypeError as error:
        raise CameraSetupError(f"camera backend {backend!r}: {error}") from error
