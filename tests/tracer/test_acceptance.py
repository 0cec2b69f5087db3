"""The optical figures that the software must reproduce: R1-R5, R7 and R8 of the acceptance list.

The expected numbers were computed by two other programs from exact Snell refraction (n = 1.53, pinhole at
z = L, first sphere touching the plane); the tolerances are the stated ones.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from rtpiv.analysis.views.field_of_view import field_of_view, radial_curve
from tracer.errors import SceneError
from tracer.media import MEDIA, ConstantMedium
from tracer.pupil import depth_of_field_mm, f_number_for_depth
from tracer.scene.scene import Scene
from tracer.scene.scene_file import load_scene
from tracer.strategies.trace import trace

EXAMPLES = Path(__file__).parents[2] / "examples"


@dataclass(frozen=True)
class Row:
    """One arrangement of the acceptance list."""

    file: str
    n: float
    inside: float | None  # R1, shares
    total: float | None
    edge: float  # R2, of R
    silhouette: float  # R3
    fold: float | None  # R4
    magnification: float | None  # R5

    def scene(self) -> Scene:
        scene = load_scene(EXAMPLES / f"{self.file}.yaml")
        glass = ConstantMedium(self.n)
        return scene.with_bodies([replace(ball, medium=glass) for ball in scene.spheres])


ROWS = {
    "one, L 1000": Row("one_sphere_1000", 1.53, 0.039, 0.242, 0.197, 1.054, 0.779, None),
    "one, L 500": Row("one_sphere_500", 1.53, 0.055, 0.249, 0.235, 1.118, 0.842, None),
    "one, L 250": Row("one_sphere_250", 1.53, 0.105, 0.264, 0.324, 1.291, 0.993, 2.243),
    "acrylic, L 250": Row("one_sphere_250", 1.49, None, None, 0.350, 1.291, None, None),
    "two, L 500": Row("two_spheres_500", 1.53, 1.34, 0.972, 1.158, 1.18, 1.127, -1.642),
    "three, L 500": Row("three_spheres_500", 1.53, 0.144, 0.278, 0.379, 1.336, 0.794, -1.654),
}
rows = pytest.mark.parametrize("row", ROWS.values(), ids=ROWS.keys())


@pytest.mark.parametrize("row", [row for row in ROWS.values() if row.inside], ids=lambda row: row.file)
def test_field_of_view_shares(row: Row) -> None:
    view = field_of_view(row.scene())
    # 0.2 points of the model, of which the printed rounding is at most half a unit of the last digit.
    assert view.inside == pytest.approx(row.inside, abs=0.002)
    assert view.total == pytest.approx(row.total, abs=0.002)


@rows
def test_radii(row: Row) -> None:
    view = field_of_view(row.scene())
    assert view.edge_mm / view.radius_mm == pytest.approx(row.edge, abs=0.002)
    assert view.silhouette_mm / view.radius_mm == pytest.approx(row.silhouette, abs=0.002)
    assert view.folds
    if row.fold is not None:
        assert view.fold_mm / view.radius_mm == pytest.approx(row.fold, abs=0.002)
    if row.magnification is not None:
        assert view.centre_magnification == pytest.approx(row.magnification, abs=0.002)


@rows
def test_the_silhouette_is_where_glass_ends(row: Row) -> None:
    scene = row.scene()
    view = field_of_view(scene)
    px_per_mm = scene.camera.focal_px / view.distance_mm
    centre = np.array(scene.camera.principal_px)
    for share, sees_glass in ((1.0 - 1e-9, True), (1.0 + 1e-9, False)):
        pixel = centre + np.array([view.silhouette_mm * share * px_per_mm, 0.0])
        assert (int(trace(scene, pixel).rays["events"]) > 0) is sees_glass


@rows
def test_the_fold_is_the_largest_plane_radius_seen_in_the_centre(row: Row) -> None:
    """By brute force on the traced map: no pixel of the centre's branch sees farther than r_b."""
    scene = row.scene()
    view = field_of_view(scene)
    radii_mm = np.linspace(0.0, view.silhouette_mm, 200_001)
    pixels = np.array(scene.camera.principal_px) + np.outer(radii_mm, [0.6, 0.8]) * (
        scene.camera.focal_px / view.distance_mm
    )
    result = trace(scene, pixels)
    seen = np.hypot(*result.plane_mm.T)
    seen[result.rays["key"] != result.rays["key"][0]] = np.nan
    until_fold = radii_mm <= view.fold_mm
    assert np.nanmax(seen[until_fold]) == pytest.approx(view.edge_mm, rel=1e-7)
    assert np.all(np.diff(seen[until_fold]) > 0.0)
    just_after = seen[~until_fold][:50]
    assert np.all(just_after < view.edge_mm)


def test_silhouette_of_every_sphere_counts() -> None:
    """Two spheres: the far one (from the plane) is nearer to the camera and has the larger cone."""
    view = field_of_view(ROWS["two, L 500"].scene())
    angle = np.arcsin(25.0 / 425.0)
    assert view.silhouette_mm == pytest.approx(500.0 * np.tan(angle), rel=1e-12)


def test_radial_curve_derivative_matches_differences() -> None:
    scene = ROWS["two, L 500"].scene()
    radii = np.linspace(-27.0, 27.0, 31)
    step = 1e-5
    ahead, behind = radial_curve(scene, radii + step)[0], radial_curve(scene, radii - step)[0]
    here, slope = radial_curve(scene, radii)
    np.testing.assert_allclose((ahead - behind) / (2.0 * step), slope, rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(here, -here[::-1], atol=1e-12)


def test_the_camera_may_be_turned() -> None:
    """The radial curve belongs to pinhole and spheres, not to where the sensor looks."""
    scene = ROWS["one, L 250"].scene()
    camera = scene.camera
    turned = replace(camera, rotation=((0.0, -1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, -1.0)), focal_px=77.0)
    assert field_of_view(scene.with_camera(turned)) == field_of_view(scene)


def test_no_glass_power_means_no_fold() -> None:
    scene = ROWS["one, L 250"].scene()
    view = field_of_view(scene.with_bodies([replace(scene.spheres[0], medium=ConstantMedium(1.0))]))
    assert not view.folds
    assert view.centre_magnification == pytest.approx(1.0, rel=1e-14)
    assert view.edge_mm == pytest.approx(view.silhouette_mm, rel=1e-12)


def test_refuses_scenes_without_a_radial_curve() -> None:
    scene = ROWS["one, L 250"].scene()
    ball = scene.spheres[0]
    with pytest.raises(SceneError, match="no sphere"):
        field_of_view(scene.with_bodies([]))
    with pytest.raises(SceneError, match=r"'ball' stands 0\.1 mm off"):
        field_of_view(scene.with_bodies([replace(ball, centre_mm=(0.1, 0.0, 50.0))]))
    with pytest.raises(SceneError, match="clear spheres"):
        field_of_view(scene.with_bodies([replace(ball, medium=None)]))
    with pytest.raises(SceneError, match="off"):
        field_of_view(load_scene(EXAMPLES / "pyramid_500.yaml"))


def test_depth_of_field() -> None:
    """R7."""
    assert depth_of_field_mm(0.14, 22.0, 532.0) == pytest.approx(83.3, rel=1e-3)
    assert f_number_for_depth(125.0, 0.14, 532.0) == pytest.approx(27.0, rel=0.01)
    assert depth_of_field_mm(0.14, f_number_for_depth(125.0, 0.14, 532.0), 532.0) == pytest.approx(125.0)
    for wrong in ((0.0, 22.0, 532.0), (0.14, -1.0, 532.0), (0.14, 22.0, float("nan"))):
        with pytest.raises(SceneError, match="positive"):
            depth_of_field_mm(*wrong)
    with pytest.raises(SceneError, match="positive"):
        f_number_for_depth(-1.0, 0.14, 532.0)


@pytest.mark.parametrize(("image_radius", "smear_px"), [(0.2, 1.1), (0.5, 2.7), (0.8, 4.2)])
def test_dispersion_smear(image_radius: float, smear_px: float) -> None:
    """R8: one 100 mm sphere of N-BK7, blue against red, in px of the L = 250 mm camera (14.8 px/mm)."""
    scene = load_scene(EXAMPLES / "one_sphere_250.yaml")
    scene = scene.with_bodies([replace(scene.spheres[0], medium=MEDIA["N-BK7"])])
    seen = [radial_curve(replace(scene, wavelength_nm=nm), image_radius * 50.0)[0] for nm in (450.0, 650.0)]
    px_per_mm = scene.camera.focal_px / 250.0
    assert abs(seen[0] - seen[1]) * px_per_mm == pytest.approx(smear_px, rel=0.05)
