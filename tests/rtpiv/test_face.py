"""The face: eight things, light to import, each where the type checker says it is."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import rtpiv

ROOT = Path(__file__).resolve().parents[2]
EIGHT = {"load_scene", "trace", "acquire", "calibrate", "correct", "evaluate", "mean", "report"}
VALUES = {
    "CorrectionRecipe",
    "Resampling",
    "PairDetails",
    "EvaluationOutput",
    "MeanOutput",
    "LiveFrames",
    "Rehearsal",
}


def test_importing_it_loads_nothing_heavy():
    code = (
        "import sys, rtpiv; print(*{m.partition('.')[0] for m in sys.modules} & {'numpy', 'numba', 'daq', 'rich'})"
    )
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert ran.stdout.split() == []


def test_eight_things_that_are_there_and_documented():
    assert set(rtpiv.__all__) == {*EIGHT, *VALUES, "ERRORS"} <= set(dir(rtpiv))
    for name in EIGHT:
        assert getattr(rtpiv, name).__doc__, name
        assert f"    {name} " in rtpiv.__doc__


def test_a_name_that_is_not_there_is_answered_with_those_that_are():
    with pytest.raises(AttributeError, match=r"no 'flow'; it has load_scene, trace"):
        rtpiv.flow  # noqa: B018


def test_the_stub_names_the_same():
    tree = ast.parse((ROOT / "rtpiv" / "__init__.pyi").read_text(encoding="utf-8"))
    named = {
        alias.name: node.module for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    assert named == rtpiv._HOMES


def every_error():
    """All classes below the root, of every package."""
    from importlib import import_module

    from ground.errors import RtpivError

    for package in ("ground", "piv", "tracer", "correction", "stages", "daq"):
        import_module(f"{package}.errors")
    left, found = [RtpivError], []
    while left:
        found.append(left.pop())
        left += found[-1].__subclasses__()
    return {each.__name__: each for each in found}


def test_one_root_catches_every_error():
    from ground.errors import ConfigError, RtpivError

    (root,) = rtpiv.ERRORS
    assert root is RtpivError
    with pytest.raises(rtpiv.ERRORS) as caught:
        raise ConfigError("scene.yaml", [])
    assert str(caught.value.place) == "scene.yaml"
    assert {"GroundError", "PivError", "TracerError", "CorrectionError", "StageError", "DaqError"} <= {
        each.__name__ for each in RtpivError.__subclasses__()
    }


def test_an_error_says_place_cure_and_exit_code():
    from ground.errors import RtpivError

    error = RtpivError("is a file", place="lab", cure="give a folder")
    assert (error.place, error.cure, error.exit_code, str(error)) == (
        "lab", "give a folder", 2, "lab: is a file; give a folder",
    )  # fmt: skip
    codes = {name: each.exit_code for name, each in every_error().items()}
    device = {"StageError", "DeviceLost", "DaqError", "CameraTimeout", "DiskError", "FrameDamaged", "MemoryShort"}
    usage = {"ConfigError", "SceneError", "PairError", "OutOfRange", "CameraUsageError", "PlanError"}
    assert {codes[name] for name in device} == {3}
    assert {codes[name] for name in usage} == {2}
    assert codes["RunInterrupted"] == 4


def test_errors_survive_a_process():
    """Workers send them back: nothing of them may be lost on the way."""
    import pickle

    from piv.errors import PairError

    error = pickle.loads(pickle.dumps(PairError("no pair", place="a.tif", cure="give another")))
    assert (str(error), error.place, error.cure) == ("a.tif: no pair; give another", "a.tif", "give another")


def test_values_go_out_and_nothing_is_printed_or_written(tmp_path, monkeypatch, capfd):
    from tests.rtpiv.analysis.series.small_series import SCENE, flow_run

    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    run = flow_run(tmp_path, 2)
    before = sorted(run.rglob("*"))
    windows = {"first_window_px": 32, "final_window_px": 16, "workers": 1}
    found = rtpiv.evaluate(run, **windows)
    assert (found.pairs, found.failed) == (2, {})
    assert found.vectors.fields["u"].shape[0] == 2
    assert found.vectors.units["u"] == "m s-1"
    mean = rtpiv.mean(run, **windows)
    assert mean.used == 2
    assert "m/s" in mean._repr_html_()
    assert "u [m s-1]" in found._repr_html_()
    (work / "scene.yaml").write_text(SCENE)
    frames = sorted((run / "frames").iterdir())[:2]
    (pair,) = rtpiv.evaluate(frames, scene="scene.yaml", final_window_px=16).details
    assert pair.vectors.units["u"] == "mm"
    rtpiv.trace("scene.yaml")
    assert sorted(run.rglob("*")) == before
    assert [path.name for path in work.iterdir()] == ["scene.yaml"]
    assert capfd.readouterr() == ("", "")
    assert rtpiv.evaluate(run, work / "kept", **windows).kept == 0
    assert (work / "kept" / "chunks" / "00000.nc").is_file()
    assert rtpiv.evaluate(run, work / "kept", **windows).kept == 2
    kept = rtpiv.mean(work / "kept")
    assert not (work / "kept" / "mean.nc").exists()
    assert kept.mean_m_s.tobytes() == mean.mean_m_s.tobytes()
