"""`rtpiv report` on small runs that lie on the disk as an acquisition leaves them."""

import json
import re
import shutil
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest

from correction.fitted import prepared
from correction.grid import grid_of
from daq.runs.displacement import Moved, write_displacements
from daq.runs.frame_accounting import FrameAccounting
from daq.runs.journal import Journal
from daq.runs.run_folder import RunFolder
from daq.runs.run_views import scene_file
from daq.runs.seal import write_record
from piv.errors import PairError
from rtpiv.analysis.report import pair_folder
from rtpiv.command_line.cli import DONE, USAGE, main
from rtpiv.verbs.evaluate import EvaluationOutput, evaluate
from sim.renderer.patterns import Chessboard, print_particles
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tests.correction.small_scenes import small_scene
from tests.daq.small_run import about_run, keep_frame, keep_step, planned
from tests.rtpiv.analysis.report.browser import measured
from tests.rtpiv.conftest import undrawn
from tracer.scene.scene_file import dump_scene

pytestmark = pytest.mark.draws

SIZE_PX = 336
SHIFT_MM = (0.9, 0.6, 0.0)
NO_PICTURES = EvaluationOutput(pictures=False)


def run_folder(path, name, prints, done=True):
    """A run whose frames show `prints`: (tag, view, print's name, print, reference or None)."""
    scene = small_scene("two_spheres_500", SIZE_PX)
    steps = [
        planned(k, tag, view, shows, reference=reference)
        for k, (tag, view, shows, _, reference) in enumerate(prints)
    ]
    known = {"plan": "p1", "scene": scene.content_hash()}
    about = about_run(steps, name=name, scene=dump_scene(scene), square_mm=8.0, disc_mm=3.2, hashes=known)
    folder = RunFolder.create(path, name, about)
    journal = Journal(folder.journal_path)
    for k, (_, view, _, print_, _) in enumerate(prints):
        seen = scene if view == "glass" else scene.with_bodies(())
        image = render(seen, print_, Sensor(), samples=3, seed=k)
        keep_frame(folder, journal, k, image, step=k, tag=prints[k][0])
        keep_step(journal, k, prints[k][0])
    journal.close()
    if done:
        books = FrameAccounting(triggered=len(prints), written=len(prints)).to_dict()
        latency = {"p50": 12.0, "p99": 20.0}
        flow = [{"corrected_live": 1, "skipped_live": 0, "latency_ms": latency}]
        done = {"utc": "now", "steps": len(prints), "frames": len(prints), "conservation": books, "sessions": []}
        write_record(folder.path / "done.json", {**done, "corrected_after_the_run": 0, "flow": flow})
    return folder


@pytest.fixture(scope="module")
def shift_run(tmp_path_factory):
    """Glass and clear pairs, and one that moved out of the plane."""
    scene = small_scene("two_spheres_500", SIZE_PX)
    scale = scene.camera.focal_px / scene.camera.position_mm[2]
    sheet = print_particles((190.0, 190.0), scale, seed=3)
    moved = sheet.displace(SHIFT_MM[:2])
    pairs = [("clear_b", "clear", SHIFT_MM), ("glass_b", "glass", SHIFT_MM), ("deep_b", "glass", (0.9, 0.6, -0.5))]
    prints, found = [], []
    for tag, view, shift in pairs:
        frames = [len(prints), len(prints) + 1]
        prints.append((tag.replace("_b", "_a"), view, "particles", sheet, None))
        prints.append((tag, view, "particles", moved, frames[0]))
        found.append(Moved(tag=tag, frames=tuple(frames), commanded_mm=shift, measured_mm=shift, true_mm=None))
    folder = run_folder(tmp_path_factory.mktemp("runs"), "shift", prints)
    write_displacements(folder, found)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(pair_folder, "write_pair_page", drawn_of_glass)
        assert main(["report", str(folder.path)]) == DONE
    return folder.path


def drawn_of_glass(evaluation, *given, write=pair_folder.write_pair_page):
    """Draw the pictures of one pair, which has them all, and of the run; the other pairs have the same ones."""
    with nullcontext() if evaluation.task.name == "glass_b" else undrawn():
        write(evaluation, *given)


def test_a_shift_run_becomes_one_page_with_all_its_pairs(shift_run):
    text = (shift_run / "report" / "report.html").read_text()
    headings = re.findall("<h2>(.*?)</h2>", text)
    for heading in ("Pairs of this run", "Displacement", "Uncertainty",
                    "Errors against the known shift", "Images", "Scene",
                    "Displacements of the target", "Frame account", "Provenance"):  # fmt: skip
        assert heading in headings
    assert "6 triggered = 6 written" in text
    head = text.partition("<h2>")[0]
    assert re.search(r"<b>\d+ %</b><span>of what the balls hide is seen through glass", head)
    assert re.search(
        r"scatter of the errors u, v of the (\d+) vectors behind glass.*<b>\1</b><span>valid vectors behind", head
    )
    judged, verdict = re.subn("68 % claimed: sigma is [^<]*", "", head)
    assert verdict == 1
    assert "seen directly" not in judged  # one region, but for the verdict, which names the worst
    assert head.count('class="slider"') == 1
    assert head.count("<img") >= 3
    assert "there is no fit beside the scene" in text
    assert "deep_b: moved by -0.500 mm along z" in text
    for tag in ("clear_b", "glass_b", "deep_b"):
        assert (shift_run / "report" / tag / "vectors.nc").is_file()
        assert (shift_run / "report" / tag / "report.html").is_file()
    for name in ("vectors", "uncertainty", "errors", "intensity", "radius", "scene"):
        assert (shift_run / "report" / f"{name}.svg").is_file()
        assert (shift_run / "report" / f"{name}.png").is_file()


@pytest.fixture(scope="module")
def evaluated(shift_run, tmp_path_factory, module_mocker):
    """Its pairs evaluated without pictures, and the scenes that were traced for it."""
    traced = module_mocker.spy(prepared, "build_ray_map")
    found = evaluate([shift_run], tmp_path_factory.mktemp("evaluated"), output=NO_PICTURES).details
    return found, [call.args[0] for call in traced.call_args_list]


def test_a_map_is_made_once_however_many_pairs_are_seen_through_it(evaluated):
    found, traced = evaluated
    assert [one.task.name for one in found] == ["clear_b", "glass_b", "deep_b"]
    assert [bool(scene.bodies) for scene in traced] == [False, True]


def test_a_phone_shows_it_without_sideways_scrolling(shift_run, tmp_path):
    seen = measured((shift_run / "report" / "report.html").read_text(), tmp_path, 390)
    assert seen["needed"] <= seen["inside"] == 390
    assert seen["loaded"]


def test_errors_are_stated_where_one_shift_is_true_for_all(shift_run):
    summaries = {
        tag: json.loads((shift_run / "report" / tag / "evaluation.json").read_text())
        for tag in ("clear_b", "glass_b", "deep_b")
    }
    assert "shift" not in summaries["deep_b"]
    assert "along z" in summaries["deep_b"]["note"]
    pitch = grid_of(small_scene("two_spheres_500", SIZE_PX).camera).pitch_mm
    for tag in ("clear_b", "glass_b"):
        shift = summaries[tag]["shift"]
        assert shift["shift_px"] == pytest.approx([SHIFT_MM[0] / pitch, -SHIFT_MM[1] / pitch])
        assert np.abs(shift["regions"]["seen directly"]["bias_px"]).max() < 0.03
    assert set(summaries["glass_b"]["vectors"]) == {"valid", "masked", "replaced", "rejected", "still"}
    assert summaries["glass_b"]["no_map_sigma"].startswith("there is no fit")


def test_a_target_run_shows_its_first_frame_through_the_glass(tmp_path):
    board = Chessboard(8.0, 3.2)
    prints = [(f"target_{view}", view, "chessboard", board, None) for view in ("clear", "glass")]
    folder = run_folder(tmp_path, "target", prints, done=False)
    assert main(["report", str(folder.path), "-o", str(tmp_path / "page")]) == DONE
    text = (tmp_path / "page" / "report.html").read_text()
    assert "Position error of target corners" in text
    assert "000001.tif, target_glass" in text
    assert "The run is not finished" in text


def add_camera(folder, name):
    """Make a further camera of a run: a copy of its folder inside it."""
    beside = folder.path / "cameras" / name
    shutil.copytree(folder.path, beside)
    write_record(folder.path / "run.json", folder.about | {"cameras": [name]})
    return beside


def test_a_run_of_two_cameras_has_a_report_of_each(tmp_path):
    board = Chessboard(8.0, 3.2)
    folder = run_folder(tmp_path, "target", [("target_glass", "glass", "chessboard", board, None)])
    add_camera(folder, "side")
    assert main(["report", str(folder.path), "-o", str(tmp_path / "page")]) == DONE
    text = (tmp_path / "page" / "report.html").read_text()
    (link,) = re.findall('href="(cameras/[^"]*)"', text)
    own = (tmp_path / "page" / link).read_text()
    assert "Position error of target corners" in own
    assert "Further cameras" not in own


def test_cameras_of_a_flow_run_are_joined(tmp_path, mocker):
    folder = run_folder(tmp_path, "flow", [("flow", "glass", "flow", Chessboard(8.0, 3.2), None)])
    beside = add_camera(folder, "side")
    mocker.patch("rtpiv.verbs.report._is_flow", return_value=True)
    joined = mocker.patch("rtpiv.verbs.report.join")
    fitted = tmp_path / "fitted.yaml"
    fitted.write_text(dump_scene(small_scene("two_spheres_500", SIZE_PX)))
    words = ["report", str(folder.path), "-o", str(tmp_path / "page")]
    assert main(words) == DONE
    assert joined.call_args.args[:3] == ([folder.path, beside], tmp_path / "page", [])
    assert main([*words, "--scene", str(fitted)]) == DONE
    first, second = joined.call_args.args[2]
    assert first == fitted
    assert second.read_text() == folder.about["scene"]
    assert main([*words, "--target-clear", str(fitted)]) == USAGE


def test_what_is_no_run_or_holds_nothing_is_one_sentence(tmp_path, capsys):
    assert main(["report", str(tmp_path)]) == USAGE
    assert "is not a run folder" in capsys.readouterr().err
    folder = run_folder(tmp_path, "target", [])
    assert main(["report", str(folder.path)]) == USAGE
    assert "holds no frame yet" in capsys.readouterr().err


def test_a_run_is_shown_as_it_was_corrected(tmp_path):
    """The scene file that the frames were corrected with, while it says the same; else the bench's as it was."""
    board = Chessboard(8.0, 3.2)
    folder = run_folder(tmp_path, "target", [("target_glass", "glass", "chessboard", board, None)])
    fitted = small_scene("two_spheres_500", SIZE_PX)
    (tmp_path / "fit.yaml").write_text(dump_scene(fitted))
    about = folder.about
    about["request"]["scene"] = str(tmp_path / "fit.yaml")
    about["hashes"]["scene for the correction"] = fitted.content_hash()
    write_record(folder.path / "run.json", about)
    assert scene_file(folder.path, tmp_path / "out") == tmp_path / "fit.yaml"
    (tmp_path / "fit.yaml").write_text(dump_scene(fitted.with_bodies(())))
    assert scene_file(folder.path, tmp_path / "out") == tmp_path / "out" / "scene.yaml"
    assert (tmp_path / "out" / "scene.yaml").read_text() == about["scene"]


def test_a_pair_that_is_none_is_named_and_left_out(shift_run, evaluated, tmp_path, mocker, capsys):
    made, names = {one.task.name: one for one in evaluated[0]}, []

    def first_fails(task, *rest):
        names.append(task.name)
        if len(names) == 1:
            raise PairError("frame B is constant")
        return replace(made[task.name], task=task)

    mocker.patch("rtpiv.verbs.evaluate.evaluate_task", first_fails)
    found = evaluate([shift_run], tmp_path, output=NO_PICTURES).details
    assert [one.task.name for one in found] == names[1:]
    assert f"{names[0]} is left out: frame B is constant" in capsys.readouterr().out.replace("\n", " ")
    mocker.patch("rtpiv.verbs.evaluate.evaluate_task", side_effect=PairError("no texture"))
    with pytest.raises(PairError, match="no texture"):
        evaluate([shift_run], tmp_path, output=NO_PICTURES)
