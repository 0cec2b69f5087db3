"""The scene of a lab, as its scene file says it."""

from rtpiv.templates.lab import Lab, medium_of_glass
from rtpiv.templates.scene_text import ball_names
from tracer.bodies import Rod, Sphere
from tracer.camera import Camera, look_at, thin_lens_distance_mm
from tracer.media import MEDIA
from tracer.scene.scene import Scene


def scene_of(lab: Lab) -> Scene:
    """Return the scene that ``scene_text`` describes, without the way through a file.

    Raises
    ------
    SceneError
        It cannot be: a ball that reaches the lens.
    """
    width, height = lab.sensor_px
    pinhole = lab.pinhole_mm
    camera = Camera(
        focal_px=thin_lens_distance_mm(lab.lens_mm, lab.distance_mm) / (lab.pixel_pitch_um * 1e-3),
        principal_px=(0.5 * (width - 1), 0.5 * (height - 1)),
        sensor_px=(width, height),
        position_mm=pinhole,
        rotation=look_at(pinhole, (0.0, 0.0, 0.0)),
    )
    each = zip(ball_names(lab), lab.centres_mm, lab.each_mm, lab.each_glass, strict=True)
    balls = [Sphere(name, centre, size / 2.0, medium_of_glass(glass)) for name, centre, size, glass in each]
    rods = [
        Rod(f"rod{number}", start, end, lab.support_mm / 2.0)
        for number, (start, end) in enumerate(lab.rods_mm, start=1)
    ]
    return Scene(camera, (*balls, *rods), lab.wavelength_nm, MEDIA["air"])
