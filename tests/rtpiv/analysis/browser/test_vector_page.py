"""The page of vectors: what a browser asks for is answered from the file, and only one file can be written."""

import json
from contextlib import contextmanager

import numpy as np
import pytest

pytest.importorskip("websockets")

from correction.grid import PlaneGrid
from piv.correlation.settings import PivSettings
from piv.files.vector_file import Vectors, read_vectors, write_vectors
from rtpiv.analysis.browser.pair_frames import PairFrames, frames_of_pair
from rtpiv.analysis.browser.vector_page import VectorPage
from rtpiv.command_line.cli import USAGE, main
from tests.daq.live.chromium import chromium, tab_at
from tests.daq.live.local_pages import browser_of, say, served

NY, NX, PITCH = 12, 16, 0.1
SHIFT = (2.3, -1.4)  # px, right and down


def vectors_of(times=2):
    x, y = np.arange(NX) * 0.8 - 6.0, np.arange(NY) * 0.8 - 4.4
    u = np.broadcast_to(0.5 + 0.01 * x, (times, NY, NX)).copy()
    v = np.broadcast_to(-0.2 + 0.02 * y[:, None], (times, NY, NX)).copy()
    u[1, 5, 7], v[1, 5, 7] = 3.0, 3.0
    u[:, 0, 0] = v[:, 0, 0] = np.nan
    flag = np.where(np.isfinite(u), 0, 1).astype(np.int8)
    fields = {"u": u, "v": v, "sigma_u": 0.01 + 0 * u, "sigma_v": 0.01 + 0 * v, "flag": flag, "chc": 1 - flag}
    units = dict.fromkeys(("u", "v", "sigma_u", "sigma_v"), "m s-1")
    attributes = {"pairs": json.dumps([f"pair{k}" for k in range(times)])}
    return Vectors(x, y, np.arange(float(times)), fields, units=units, attributes=attributes)


@pytest.fixture(scope="module")
def frames():
    """Particle images moved by SHIFT: Gaussians drawn at their exact places."""
    random, side = np.random.default_rng(3), 144
    places, rows, columns = random.uniform(0, side, (900, 2)), *np.indices((side, side))
    pair = []
    for sign in (-0.5, 0.5):
        frame = random.normal(20.0, 1.0, (side, side))
        for row, column in places + sign * np.array(SHIFT[::-1]):
            frame += 200.0 * np.exp(-((rows - row) ** 2 + (columns - column) ** 2) / 2.0)
        pair.append(frame.astype(np.float32))
    grid = PlaneGrid((-7.2, 7.2), PITCH, (side, side))
    return PairFrames(*pair, np.ones((side, side), bool), grid, PivSettings((32, 32)))


@contextmanager
def shown(folder, frames="frames are not shown: no scene"):
    path = folder / "vectors.nc"
    write_vectors(path, vectors_of())
    with served(VectorPage(path, read_vectors(path), frames)) as page:
        yield page


@contextmanager
def looking(page, token=None, **options):
    """What a browser is told first, and a way to ask for more."""
    with browser_of(page, "/vectors", token, **options) as browser:
        about = json.loads(browser.recv(5.0))

        def ask(words, follows=False):
            said = say(browser, words)
            return (said, browser.recv(5.0)) if follows else said

        yield about, ask


def test_the_file_arrives_as_it_is(tmp_path):
    with shown(tmp_path) as page, looking(page) as (about, ask):
        assert (about["times"], len(about["x"]), len(about["y"]), about["writes"]) == (
            2,
            NX,
            NY,
            "vectors-checked.nc",
        )
        words, content = ask({"time": 1}, follows=True)
        assert words == {"time": 1, "tag": "pair1"}
        arrived = np.frombuffer(content, "<f4").reshape(len(about["names"]), NY, NX)
        np.testing.assert_array_equal(arrived[about["names"].index("u")], vectors_of().fields["u"][1].astype("f4"))


def test_what_fails_the_criteria_is_shown_before_it_is_written_and_the_rest_stays(tmp_path):
    with shown(tmp_path) as page, looking(page) as (_, ask):
        for criteria in ({"local_median": 3.0}, {"deviations": 5.0}, {"u_limits": [-1, 1], "v_limits": [-1, 1]}):
            assert ask({"check": criteria, "time": 1}) == {"rejected": [5 * NX + 7], "measured": NX * NY - 1}
            assert ask({"check": criteria, "time": 0})["rejected"] == []
        assert not (tmp_path / "vectors-checked.nc").exists()
        assert ask({"write": {"local_median": 3.0}}) == {"written": "vectors-checked.nc", "rejected": 1}
        left_out, before = read_vectors(tmp_path / "vectors-checked.nc"), vectors_of()
        assert np.isnan(left_out.fields["u"][1, 5, 7])
        assert np.isnan(left_out.fields["sigma_v"][1, 5, 7])
        assert left_out.fields["flag"][1, 5, 7] == 3
        assert json.loads(left_out.attributes["post_processing"]) == {"local_median": 3.0, "interpolate": False}
        others = np.ones((2, NY, NX), bool)
        others[1, 5, 7] = False
        for name in ("u", "sigma_u", "chc"):
            np.testing.assert_array_equal(left_out.fields[name][others], before.fields[name][others].astype("f4"))
        assert ask({"write": {"local_median": 3.0, "interpolate": True}})["rejected"] == 1
        filled = read_vectors(tmp_path / "vectors-checked.nc")
        assert filled.fields["u"][1, 5, 7] == pytest.approx(0.5 + 0.01 * before.x_mm[7], abs=1e-3)
        assert filled.fields["flag"][1, 5, 7] == 2
        assert filled.fields["chc"][1, 5, 7] == 0
        assert np.isnan(filled.fields["sigma_u"][1, 5, 7])


NONSENSE = (
    {}, [], "nonsense", b"\xff\xfe", {"time": 2}, {"time": -1}, {"time": True}, {"time": "0"}, {"frame": "a"},
    {"check": {"colour": 1}}, {"check": []}, {"check": {"deviations": -1}}, {"check": {"u_limits": [1, 0]}},
    {"check": {"u_limits": [1]}}, {"write": {"v_limits": "ab"}}, {"write": {"local_median": 10**400}},
    {"windows": [0, 0]}, '{"check": {"deviations": NaN}}', '{"write": ' + 500 * "[" + 500 * "]" + "}",
)  # fmt: skip


def test_nonsense_is_refused_in_one_sentence_and_writes_nothing(tmp_path):
    with shown(tmp_path) as page, looking(page) as (_, ask):
        for said in NONSENSE:
            assert set(ask(said)) == {"refused"}, said
        assert sorted(path.name for path in tmp_path.iterdir()) == ["vectors.nc"]
        assert "rejected" in ask({"check": {}})  # and is served on


def test_a_file_that_cannot_be_written_is_refused_with_the_reason(tmp_path):
    with shown(tmp_path) as page, looking(page) as (_, ask):
        (tmp_path / "vectors-checked.nc").mkdir()
        assert "vectors-checked.nc: is a directory" in ask({"write": {}})["refused"].lower()


@pytest.mark.slow
def test_other_windows_at_a_place_find_the_displacement_and_frames_are_sent(tmp_path, frames):
    with shown(tmp_path, frames) as page, looking(page) as (about, ask):
        assert about["frame"]["width"] == 144
        words, content = ask({"frame": "b"}, follows=True)
        assert words == {"frame": "b"}
        grey = np.frombuffer(content, np.uint8).reshape(144, 144)
        assert np.corrcoef(grey.ravel(), np.clip(frames.b, 15, 300).ravel())[0, 1] > 0.95
        rows = {row["side"]: row for row in ask({"windows": [0.3, -0.5]})["windows"]}
        for side in (24, 32, 48):
            row = rows[side]
            assert (row["u"], row["v"]) == pytest.approx((SHIFT[0], -SHIFT[1]), abs=0.06)
            assert 0.0 < row["sigma_u"] < 0.1
            assert row["off"] < 24.0
        assert ask({"windows": [50.0, 0.0]})["refused"] == "choose a place among the vectors"


def test_frames_are_shown_only_with_the_scene_of_the_evaluation(tmp_path):
    path = tmp_path / "vectors.nc"
    assert "no evaluation.json" in frames_of_pair(path, "abc", None)
    about = {"frames": "a.tif, b.tif", "frames_from": str(tmp_path), "correlation": {"windows_px": [32, 32]}}
    (tmp_path / "evaluation.json").write_text(json.dumps(about))
    assert "pass the scene of the evaluation with --scene" in frames_of_pair(path, "abc", None)
    (tmp_path / "evaluation.json").write_text(json.dumps(about | {"frames": 5}))
    assert "no evaluation.json" in frames_of_pair(path, "abc", None)


def test_the_verb_says_which_results_a_folder_holds(tmp_path, capsys):
    (tmp_path / "pair1").mkdir()
    for words in (["report", "--view", str(tmp_path)],):
        assert main(words) == USAGE
        assert "holds no vectors.nc or mean.nc" in capsys.readouterr().err
        (tmp_path / "pair1" / "vectors.nc").write_bytes(b"CDF")
        assert main(words) == USAGE
        assert f"name one of them, such as {tmp_path / 'pair1' / 'vectors.nc'}" in capsys.readouterr().err.replace(
            "\n", " "
        )
    assert main(["report", "--view", str(tmp_path / "pair1")]) == USAGE
    assert "not a NetCDF file of vectors" in capsys.readouterr().err.replace("\n", " ")


def enter(tab, name, value, event):
    """Give an element of the page a value, as a person does."""
    tab.value(f"document.getElementById('{name}').value = '{value}'")
    tab.value(f"document.getElementById('{name}').dispatchEvent(new Event('{event}'))")


@pytest.mark.slow
@pytest.mark.skipif(chromium() is None, reason="there is no Chromium on this computer")
def test_a_person_rejects_a_vector_draws_a_line_and_writes(tmp_path, frames):
    with shown(tmp_path, frames) as page, tab_at(page.access.url) as tab:
        tab.until("document.getElementById('checked')?.textContent.startsWith('0 of ')")
        enter(tab, "time", 1, "change")
        tab.until("document.getElementById('run').textContent.endsWith('pair1')")
        enter(tab, "local_median", 3, "input")
        tab.until("document.getElementById('checked').textContent.startsWith('1 of 191')")
        enter(tab, "frame", "a", "change")
        tab.until("image !== null")
        tab.value("line = [[-4, 0], [4, 0]]; showLine()")
        tab.until("document.getElementById('line').textContent.includes('over 8 mm')")
        tab.value("place = [0.4, -0.4]; send({ windows: place })")
        tab.until("document.getElementById('windows').rows.length === 7")
        tab.value("document.getElementById('write').click()")
        tab.until("document.getElementById('state').textContent.startsWith('vectors-checked.nc is written: 1')")
        for width in (1400, 420):  # a wide and a narrow screen: nothing sticks out
            tab.picture(tmp_path / f"{width}.png", width, 900)
            assert tab.value("document.documentElement.scrollWidth <= window.innerWidth")
        assert np.isnan(read_vectors(tmp_path / "vectors-checked.nc").fields["u"][1, 5, 7])
