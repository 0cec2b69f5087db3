"""The text of scene.yaml for a lab, and the scene that this file says."""

from rtpiv.templates.lab import Lab, medium_of_glass
from tracer.bodies import Rod, Sphere
from tracer.camera import Camera, look_at, thin_lens_distance_mm
from tracer.media import MEDIA, ConstantMedium, known_media
from tracer.scene.scene import Scene

NAMES = {
    ("behind", 1): ("ball",),
    ("triangle", 3): ("top", "left", "right"),
    ("pyramid", 4): ("top", "left", "right", "tip"),
    ("pyramid", 5): ("southwest", "southeast", "northeast", "northwest", "tip"),
}
ROD = "  # - {name: rod, kind: rod, start_mm: [0.0, -40.0, 24.0], end_mm: [0.0, -90.0, 24.0], radius_mm: 4.0}\n"


def ball_names(lab: Lab) -> tuple[str, ...]:
    """Names of the balls, in the order of `centres_mm`."""
    return NAMES.get((lab.arrangement, lab.balls)) or tuple(f"ball{number + 1}" for number in range(lab.balls))


def _material(glass: str) -> str:
    return f"{{n: {glass}}}" if isinstance(medium_of_glass(glass), ConstantMedium) else repr(glass)


def _position(lab: Lab) -> str:
    """Where the pinhole of a camera is that looks askew, and where its axis meets the plane; or how to say it."""
    hide = "" if lab.turn_deg else "# "
    x, y, z = lab.pinhole_mm
    return (
        f"  {hide}position_mm: [{x:g}, {y:g}, {z:g}]   # of the pinhole, and where its axis meets the plane, if"
        " askew\n"
        f"  {hide}look_at_mm: [0.0, 0.0, 0.0]"
    )


def scene_text(lab: Lab) -> str:
    """Return the file."""
    width, height = lab.sensor_px
    wide = max(map(len, ball_names(lab)))
    bodies = [
        f"  - {{name: {name + ',':{wide + 1}} kind: sphere, centre_mm: [{x:.4f}, {y:.4f}, {z:.4f}], "
        f"radius_mm: {size / 2.0:.4g}, material: {_material(glass)}}}"
        for name, (x, y, z), size, glass in zip(
            ball_names(lab), lab.centres_mm, lab.each_mm, lab.each_glass, strict=True
        )
    ]
    bodies += [
        f"  - {{name: rod{number}, kind: rod, start_mm: [{', '.join(f'{c:.4f}' for c in start)}], "
        f"end_mm: [{', '.join(f'{c:.4f}' for c in end)}], radius_mm: {lab.support_mm / 2.0:.4g}}}  # opaque"
        for number, (start, end) in enumerate(lab.rods_mm, start=1)
    ]
    hold = "" if lab.support_mm else ROD
    field = " x ".join(f"{side:.0f}" for side in lab.field_mm)
    lines = "\n".join(bodies)
    return f"""\
# yaml-language-server: $schema=schemas/scene.schema.json
# What we know of our bench. The world is in mm: the investigation plane (target, light sheet) is z = 0, x to the
# right and y up as the camera sees it, z towards the camera. A millimetre is good enough: `rtpiv calibrate` finds
# the rest, but for what lights the target: say that under `fit`.
wavelength_nm: {lab.wavelength_nm:g}        # of the light, in vacuum: 532 for a doubled Nd:YAG laser
ambient: air
camera:                     # sees {field} mm of the plane without glass, {lab.px_per_mm:.1f} px/mm
  f_mm: {lab.lens_mm:g}                  # focal length of the lens
  L_mm: {lab.distance_mm:g}                 # from the lens (its entrance pupil) to the plane
  pixel_pitch_um: {lab.pixel_pitch_um:g}       # data sheet of the camera
  sensor_px: [{width}, {height}]   # width, height of its frames
{_position(lab)}
# material: {known_media()}
# or your own: {{n: 1.492}} at this wavelength
bodies:
{lines}
{hold}# sheet: {{z_mm: 0.0, sigma_mm: 0.5}}  # the light sheet, where it is not quite the plane of the target
fit:                        # what `rtpiv calibrate` goes by
  # what lights the target: here the laser itself, as on the simulated bench. Glass has another index in another
  # light: in place of it say yours, {{mean_nm: 530, width_nm: 30}} for a green LED ({{mean_nm: 530, source: lamp}}
  # if you know no width), {{colour_temperature_k: 5000}} for a white one, or better the lamp's spectrum as points
  light: {{source: laser}}
  # spheres: {{centre_mm: 1.0, radius_mm: 0.02}}   # what it may change: standard deviations, the defaults
  # n: 0.005
"""


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
