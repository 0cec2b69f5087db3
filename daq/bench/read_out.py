"""From the sensor to the image that a camera sends of it: reversal, binning, decimation, region, for the scene.

SFNC applies them in this order.  With n pixels of the sensor to one of the image, whose first is pixel o,

    u_image = (u_sensor - o + 1/2) / n - 1/2     binning: a pixel is the mean of n
    u_image = (u_sensor - o) / n                 decimation: of n pixels the first is sent
    u_image = (width - 1) - u_sensor             ReverseX and ReverseY together: the camera rolled by 180 degrees

and the principal distance in pixels is n times shorter.  A scene has one distance for both directions and a camera
that is no mirror, so unequal factors, and one reversal alone, are refused: such an image of a sensor no scene
describes.

A bench file's scene describes the image by default; with `scene_shows: sensor` it describes the whole sensor, and
what the settings make of it is worked out here.
"""

from collections.abc import Mapping
from dataclasses import replace

from daq.cameras.camera import Setting
from daq.errors import SettingRefused
from tracer.camera import Camera, Vector3

AXES = ("Horizontal", "Vertical")
REVERSED = ("ReverseX", "ReverseY")


def require_squares(settings: Mapping[str, Setting]) -> None:
    """Refuse settings that make pixels no scene describes; SettingRefused."""
    for name in ("Binning", "Decimation"):
        across, down = (_whole(settings, f"{name}{axis}", 1) for axis in AXES)
        if across != down:
            raise SettingRefused(
                f"{name}Horizontal {across} and {name}Vertical {down} make pixels that are not square, which a "
                "scene cannot describe; set both to the same value"
            )


def image_of(camera: Camera, settings: Mapping[str, Setting]) -> Camera:
    """Camera whose sensor is the image that is sent.

    Parameters
    ----------
    camera : Camera
        With the whole sensor.
    settings : mapping
        Of the bench file; Width and Height are the rest of the sensor where they are not said.

    Raises
    ------
    SettingRefused
        The image does not lie on the sensor, or no scene describes it.
    """
    require_squares(settings)
    if len({settings.get(name, False) is True for name in REVERSED}) > 1:
        raise SettingRefused(
            "one of ReverseX and ReverseY alone mirrors the image, which a scene cannot describe; set "
            "both or none, or describe the image itself (scene_shows: image), as behind a mirror"
        )
    if settings.get("ReverseX", False) is True:
        camera = _half_turn(camera)
    for name, half in (("Binning", 0.5), ("Decimation", 0.0)):
        camera = _coarser(camera, _whole(settings, f"{name}Horizontal", 1), half)
    offset = (_whole(settings, "OffsetX", 0), _whole(settings, "OffsetY", 0))
    size = (
        _whole(settings, "Width", camera.sensor_px[0] - offset[0]),
        _whole(settings, "Height", camera.sensor_px[1] - offset[1]),
    )
    ends = (offset[0] + size[0], offset[1] + size[1])
    if min(size) < 1 or ends[0] > camera.sensor_px[0] or ends[1] > camera.sensor_px[1]:
        gives = f"{camera.sensor_px[0]} x {camera.sensor_px[1]} px"
        raise SettingRefused(
            f"an image of {size[0]} x {size[1]} px at {offset[0]}, {offset[1]} is not within a sensor that "
            f"gives {gives}; if the scene file describes the image, set scene_shows: image"
        )
    u, v = camera.principal_px
    return replace(camera, sensor_px=size, principal_px=(u - offset[0], v - offset[1]))


def _half_turn(camera: Camera) -> Camera:
    """Turned by half a turn about its axis; tangential lens terms are even, so they change their sign."""
    (width, height), (u, v) = camera.sensor_px, camera.principal_px
    right, down, forward = camera.rotation
    rotation = (_back(right), _back(down), forward)
    lens = replace(camera.lens, p1=-camera.lens.p1, p2=-camera.lens.p2)
    return replace(camera, rotation=rotation, lens=lens, principal_px=(width - 1 - u, height - 1 - v))


def _back(way: Vector3) -> Vector3:
    return (-way[0], -way[1], -way[2])


def _coarser(camera: Camera, factor: int, half: float) -> Camera:
    if factor == 1:
        return camera
    size = (camera.sensor_px[0] // factor, camera.sensor_px[1] // factor)
    u, v = ((c + half) / factor - half for c in camera.principal_px)
    return replace(camera, focal_px=camera.focal_px / factor, principal_px=(u, v), sensor_px=size)


def _whole(settings: Mapping[str, Setting], name: str, default: int) -> int:
    value = settings.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int) or value < (1 if default == 1 else 0):
        raise SettingRefused(f"{name} = {value!r} is not a number of pixels")
    return value
