"""Two cameras without glass, from frames of another program: u, v and w in one command.

The frames are made here, with a projection of their own: a pinhole at distance D, turned about the y axis.
"""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import tifffile
from scipy.io import netcdf_file

from correction.light_sheet.two_cameras import SheetByViews
from ground.terminal import console
from piv.files.vector_file import read_vectors
from rtpiv.analysis.series.joined_views import JoinedViews
from rtpiv.command_line.cli import DONE, USAGE, main
from rtpiv.example_files import examples
from rtpiv.verbs.join import _is_one_run, show_contradictions
from tests.daq.cameras.rigs import need_harvesters
from tests.piv.conftest import draw
from tracer.light_sheet import LightSheet
from tracer.scene.scene_file import load_scene

SIDE, FOCAL_PX, DISTANCE_MM = 128, 1500.0, 300.0
PX_MM = DISTANCE_MM / FOCAL_PX
SPEED_PX = np.array([2.2, -1.1, 1.4])  # y up, z towards the cameras
PAIRS, DT_US = 3, 200.0
WINDOWS = ("--first-window", "32", "--final-window", "32", "--workers", "1")


def project(points_mm, degrees, tilt_deg=0.0, sensor_px=SIDE):
    """Pixels u, v of points: the pinhole stands at D (sin, 0, cos) and looks at the origin.

    The sensor is turned about its v axis (Scheimpflug): u' = u cos - ahead sin, through f ahead.
    """
    angle = np.deg2rad(degrees)
    x, y, z = points_mm.T
    across = x * np.cos(angle) - z * np.sin(angle)
    depth = DISTANCE_MM - (x * np.sin(angle) + z * np.cos(angle))
    middle, tilt = 0.5 * (sensor_px - 1), np.deg2rad(tilt_deg)
    along = FOCAL_PX * np.cos(tilt) / (depth * np.cos(tilt) + across * np.sin(tilt))
    u = along * across * np.cos(tilt) - (along * depth - FOCAL_PX) * np.sin(tilt)
    return middle + u, middle - along * y


def write_camera(folder, degrees, sheet=(0.0, 0.0, 0.0), offset_px=(0.0, 0.0), tilt_deg=0.0):
    """Frames of particles in a sheet of 0.5 mm at z = z_0 + s_x x + s_y y, and the scene of the camera."""
    (folder / "frames").mkdir(parents=True)
    angle, rng, noise = np.deg2rad(degrees), np.random.default_rng(1), np.random.default_rng(int(degrees) + 90)
    place = [float(DISTANCE_MM * np.sin(angle)), 0.0, float(DISTANCE_MM * np.cos(angle))]
    (folder / "scene.yaml").write_text(
        f"camera: {{focal_px: {FOCAL_PX}, sensor_px: [{SIDE}, {SIDE}], position_mm: {place},"
        f" look_at_mm: [0, 0, 0], sensor_tilt_deg: [0.0, {tilt_deg}]}}\nbodies: []\n"
    )
    for pair in range(PAIRS):
        points = rng.uniform(-1.0, 1.0, (2600, 3)) * (0.75 * SIDE * PX_MM, 0.75 * SIDE * PX_MM, 0.25)
        points[:, 2] += sheet[0] + points[:, :2] @ sheet[1:]
        light = rng.uniform(200.0, 600.0, len(points))
        for way, letter in ((-0.5, "a"), (0.5, "b")):
            u, v = project(points + way * PX_MM * SPEED_PX, degrees, tilt_deg)
            image = draw((SIDE, SIDE), u + offset_px[0], v + offset_px[1], 2.4, light)
            image += noise.normal(40.0, 3.0, image.shape)
            name = folder / "frames" / f"{pair:03d}_{letter}.tif"
            tifffile.imwrite(name, np.clip(np.rint(image), 0, 4095).astype(np.uint16))
    return folder


def join(cameras, out, *more):
    scenes = [str(camera / "scene.yaml") for camera in cameras]
    frames = [str(camera / "frames") for camera in cameras]
    return main(
        ["mean", "--join", *frames, "--scene", *scenes, "--dt-us", str(DT_US), "-o", str(out), *WINDOWS, *more]
    )


def read(path):
    with netcdf_file(path, mmap=False) as file:
        fields = {name: np.array(one[:]) for name, one in file.variables.items()}
        return fields, {name: getattr(file, name) for name in ("runs", "px_per_mm")}


def joined_of(residuals):
    """Views of one place whose residuals are these: of all, then without each."""
    place, one = np.zeros((1, 1, 3)), np.ones((1, 1))
    return JoinedViews(
        np.zeros(1), np.zeros(1), place, place, place, one.astype(np.uint8), one.astype(np.uint8), one, residuals,
        (0.2, 0.3, 0.5), None, one, 1.0, "m/s",
    )  # fmt: skip


def test_the_view_that_disagrees_is_named():
    assert joined_of((1.1,)).warning == ""
    assert joined_of((float("nan"),)).warning == ""
    assert "without view" not in joined_of((4.0,)).warning  # two views: either may be wrong
    assert joined_of((4.0, 3.9, 1.1, 4.2)).warning.endswith("without view 2 they agree")
    assert "without view" not in joined_of((4.0, 3.9, 3.1, 4.2)).warning
    assert "50 % is recovered: 20 % by view 1, 30 % by view 2" in " ".join(joined_of((1.1,)).sentences)


def test_views_that_contradict_each_other_are_named(capsys):
    paths, sure = [Path("left"), Path("right")], LightSheet(sigma_mm=0.02)

    def said(known, z_mm=0.3, residual=1.2, moved=(), **more):
        found = SheetByViews(np.array([z_mm, 0.0, 0.0]), 1e-6 * np.eye(3), 0.02, residual, 100, moved, 0.1, **more)
        show_contradictions(console(), found, paths, known)
        return " ".join(capsys.readouterr().out.split())

    assert "the light sheet lies +0.300 +- 0.020 mm from where" in said(sure)
    assert said(sure, z_mm=0.05) == said(LightSheet(sigma_mm=0.5)) == said(None) == ""
    assert "0.020 mm apart (3.0 sigma)" in said(sure, z_mm=0.0, residual=3.0)
    assert said(sure, moved=(1,)).startswith("the camera of view 2 (right) was moved since it was calibrated")
    assert "of view 1 (left) or view 2 (right) was moved" in said(sure, moved=(0, 1))
    alone = {"unseen": np.array([1e9, 1e-2, 0.1, 1e-5, 1e-3, 1e-4]), "as_height": np.array([3.0, 0, 0, 0, 0, 0])}
    assert "less than 0.027, 0.01, 0.1 mm" in said(sure, z_mm=0.0, **alone)
    assert "less than any amount, 0.01, 0.1 mm along" in said(None, **alone)


def test_cameras_of_one_run_are_at_the_same_time(tmp_path):
    run = tmp_path / "run"
    beside, other = run / "cameras" / "behind", run / "cameras" / "above"
    for folder in (run / "series", beside / "series"):
        folder.mkdir(parents=True)
        (folder / "series.json").touch()
    (run / "run.json").touch()
    assert _is_one_run([run, beside])
    assert _is_one_run([beside, other])
    assert _is_one_run([run / "series", beside / "series"])
    assert not _is_one_run([run, tmp_path / "another"])
    for name in ("left", "right"):  # such as two runs of a campaign
        (tmp_path / name).mkdir()
        (tmp_path / name / "series.json").touch()
    assert not _is_one_run([tmp_path / "left", tmp_path / "right"])


def test_scenes_are_as_many_as_views(tmp_path, capsys):
    assert main(["mean", "--join", "a", "b", "--scene", "one.yaml", "-o", str(tmp_path / "out")]) == USAGE
    assert "one for each, not 2 and 1" in " ".join(capsys.readouterr().err.split())


def test_series_are_not_evaluated_in_another_way(tmp_path, capsys):
    for name in "ab":
        (tmp_path / name).mkdir()
        (tmp_path / name / "series.json").touch()
    views = [str(tmp_path / name) for name in "ab"]
    assert main(["mean", "--join", *views, "--dt-us", "100", "-o", str(tmp_path / "out")]) == USAGE
    assert "give runs or frames" in " ".join(capsys.readouterr().err.split())


@pytest.mark.slow
@pytest.mark.parametrize("views", [((-20.0, 0.0), (20.0, 0.0)), ((0.0, 0.0), (41.0, 7.0))])
def test_two_cameras_give_three_components(tmp_path, capsys, views):
    cameras = [
        write_camera(tmp_path / f"camera{k}", degrees, tilt_deg=tilt) for k, (degrees, tilt) in enumerate(views)
    ]
    out = tmp_path / "joined"
    assert join(cameras, out, "--simultaneous") == DONE
    assert "residual of the views" in capsys.readouterr().out
    fields, about = read(out / "chunks" / "00000.nc")
    assert len(json.loads(about["runs"])) == 2
    to_px = 1e-3 * DT_US * float(about["px_per_mm"])  # of m/s
    scale = PX_MM * float(about["px_per_mm"])  # a pixel of the corrected image is one of the first camera's grid
    inner = (slice(None), slice(1, -1), slice(1, -1))
    for k, name in enumerate("uvw"):
        off = (fields[name] * to_px - scale * SPEED_PX[k])[inner]
        sigma = (fields[f"total_sigma_{name}"] * to_px)[inner]
        assert np.isfinite(off).mean() > 0.95
        assert np.sqrt(np.nanmean(off**2)) < (0.035, 0.035, 0.07)[k]
        assert 0.5 < np.nanmean(np.abs(off) < sigma) < 0.97
    if views[1][1] == 0.0:
        # w = (u_2 - u_1)/(a_1 - a_2) with slopes of +-tan 20: sigma_w = sigma_u sqrt(2)/(2 tan 20)
        noise = np.nanmedian(fields["sigma_w"][inner]) / np.nanmedian(fields["sigma_u"][inner])
        assert noise == pytest.approx(1.0 / np.tan(np.deg2rad(20.0)), rel=0.1)
    mean, _ = read(out / "mean.nc")
    assert np.nanmean(mean["w"]) * to_px == pytest.approx(scale * SPEED_PX[2], abs=0.02)
    assert {"R_uw", "R_vw", "R_ww"} <= set(mean)
    assert (out / "mean.html").is_file()
    assert join(cameras[:1] * 2, tmp_path / "twice") == USAGE
    assert "same vectors" in capsys.readouterr().err


@pytest.mark.slow
def test_the_sheet_is_found_where_it_is(tmp_path, capsys):
    sheet = (0.6, 0.02, -0.015)
    cameras = [write_camera(tmp_path / f"camera{k}", degrees, sheet) for k, degrees in enumerate((-20.0, 20.0))]
    out = tmp_path / "joined"
    assert join(cameras, out, "--simultaneous", "--sheet") == DONE
    assert "stand where" not in capsys.readouterr().out
    found = load_scene(out / "view-2" / "scene.yaml").sheet
    assert found.z_mm == pytest.approx(sheet[0], abs=0.02)  # 3 pairs of 128 px; the sheet is 0.5 thick
    assert abs(found.z_mm - sheet[0]) < 4.0 * found.sigma_mm
    for tilt, slope in zip((found.tilt_x_deg, found.tilt_y_deg), sheet[1:], strict=True):
        assert tilt == pytest.approx(np.rad2deg(np.arctan(slope)), abs=0.15)
        assert abs(tilt - np.rad2deg(np.arctan(slope))) < 4.0 * found.tilt_sigma_deg


@pytest.mark.slow
def test_a_camera_that_was_moved_is_no_sheet(tmp_path, capsys):
    cameras = [
        write_camera(tmp_path / f"camera{k}", degrees, offset_px=offset)
        for k, (degrees, offset) in enumerate(((-20.0, (0.0, 0.0)), (20.0, (0.0, 0.5))))
    ]
    assert join(cameras, tmp_path / "joined", "--simultaneous", "--sheet") == DONE
    assert "does not stand where it was calibrated" in " ".join(capsys.readouterr().out.split())


@pytest.mark.slow
def test_branches_need_places_that_are_seen_twice(tmp_path, capsys):
    camera = write_camera(tmp_path / "camera", 0.0)
    assert join([camera], tmp_path / "joined", "--branches") == USAGE
    assert "sees places on two paths" in " ".join(capsys.readouterr().err.split())
    assert join([camera], tmp_path / "other") == USAGE


@pytest.mark.parametrize("how", ["--knocks", "--follow", "--sheet"])
def test_one_camera_has_nothing_to_compare_its_frames_with(tmp_path, capsys, how):
    (tmp_path / "frames").mkdir()
    for letter in "ab":
        tifffile.imwrite(tmp_path / "frames" / f"000_{letter}.tif", np.full((SIDE, SIDE), 40, np.uint16))
    (tmp_path / "scene.yaml").write_text(
        f"camera: {{focal_px: {FOCAL_PX}, sensor_px: [{SIDE}, {SIDE}], position_mm: [0, 0, {DISTANCE_MM}],"
        " look_at_mm: [0, 0, 0]}\nbodies: []\n"
    )
    assert join([tmp_path], tmp_path / "joined", "--branches", how) == USAGE
    assert "of two cameras at the same time" in " ".join(capsys.readouterr().err.split())


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    ("bodies", "side", "lens"),
    [
        (True, "position_mm: [129.41, 0.0, 482.96]", ""),
        # Without its tilt the sensor of a camera at 41 degrees would be sharp in a stripe: f/2.8 blurs by 5 px.
        (False, "position_mm: [328.03, 0.0, 377.35], sensor_tilt_deg: [0.0, -6.76]", "[0.0, -6.76]"),
    ],
)
def test_a_flow_run_of_two_cameras_from_the_live_pages_to_its_report(
    tmp_path, monkeypatch, capsys, bodies, side, lens
):
    """On the simulated bench, without a replacement: nothing is lost, and w is that of the flow."""
    need_harvesters()
    monkeypatch.chdir(tmp_path)
    camera = "camera: {f_mm: 60.0, L_mm: 500.0, pixel_pitch_um: 66.0, sensor_px: [336, 336]"
    scene = (examples() / "two_spheres_500.yaml").read_text()
    if not bodies:
        scene = re.sub(r"^bodies:\n(?:  .*\n)+", "bodies: []\n", scene, flags=re.MULTILINE)
    for name, more in (("two_spheres_500", ""), ("side", f", {side}")):
        (tmp_path / f"{name}.yaml").write_text(
            re.sub(r"^camera: \{.*\}", f"{camera}{more}}}", scene, flags=re.MULTILINE)
        )
    bench = (examples() / "bench-flow.yaml").read_text()
    own = re.search(r"^camera:\n((?:  .*\n)+)", bench, re.MULTILINE).group(1)
    side = "  side:\n    kind: camera\n    scene: side.yaml\n" + re.sub("^", "  ", own, flags=re.MULTILINE)
    shear = "{velocity_mm_s: [400, 800, 60], gradient_per_s: [[0, 2, 0], [0, 0, 0], [2, 0, 0]]}"
    flow = f"  is_misaligned: false\n  flow: {{field: shear, parameters: {shear}, turbulence: null}}\n"
    if lens:
        pupil = "aperture: {f_mm: 60.0, f_number: 2.8, focus_mm: 500.0"
        flow += f"  {pupil}}}\n  cameras: {{side: {{{pupil}, sensor_tilt_deg: {lens}}}}}}}\n"
        bench = re.sub(r"^  contact: .*\n", "", bench, flags=re.MULTILINE)
    bench = bench.replace("devices:\n", f"devices:\n{side.rstrip()}\n").replace("  flow: {field: jet}\n", flow)
    (tmp_path / "bench.yaml").write_text(bench)
    plan = (examples() / "plan-flow.yaml").read_text().replace("background: {pairs: 50}\n", "")
    plan = plan.replace("pairs: 1000", "pairs: 6") + "cameras: [side]\n"
    (tmp_path / "plan.yaml").write_text(plan if bodies else plan.replace("view: glass", "view: clear"))
    words = ["acquire", "plan.yaml", "--bench", "bench.yaml", "--simulate", "--home", "--operator", "me", "--live"]
    assert main(words) == DONE
    said = capsys.readouterr().out
    assert len(re.findall(r"^look at http.* \((?:camera|side)\)$", said, re.MULTILINE)) == 2
    assert "0 are lost" in said
    (run,) = (tmp_path / "runs").glob("*_plan")
    assert main(["check", str(run)]) == DONE
    assert main(["report", str(run)]) == DONE
    said = " ".join(capsys.readouterr().out.split())
    assert "residual of the views" in said
    assert "does not stand where" not in said
    assert "lies" not in said  # the sheet is where the scenes have it
    found = read_vectors((run / "report" / "mean.nc").read_bytes())
    to_px = 0.5 * float(found.attributes["px_per_mm"])  # of m/s in 500 us
    x = np.broadcast_to(found.x_mm, found.fields["w"][0].shape)
    off = found.fields["w"][0] * to_px - (0.06 + 2e-3 * x) * to_px
    assert np.isfinite(off).mean() > 0.8
    assert np.sqrt(np.nanmean(off**2)) < 0.05
    assert {"status_1", "status_2", "R_ww"} <= set(found.fields)
    assert (run / "report" / "mean.html").is_file()
