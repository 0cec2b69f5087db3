"""Every problem of a file comes at once, in words that stand in the file; no sentence is the library's."""

import pytest
from pydantic import TypeAdapter

from daq.bench.bench_table import BenchTable
from daq.plans.plan import EXPERIMENTS, plan_table
from ground import plain_words
from ground.config import Document, open_document, validate
from ground.errors import ConfigError
from rtpiv.analysis.pairs.piv_file import PivTable
from tests.loops import loop_over
from tracer.media import MEDIA, medium_called
from tracer.scene.scene_file import load_priors, load_scene
from tracer.scene.scene_tables import SceneTable

HEAD = """\
wavelength_nm: 532
camera: {f_mm: 50, L_mm: 600, pixel_pitch_um: 3.45, sensor_px: [1224, 1024]}
bodies:
"""
GOOD = "  - {name: a, kind: sphere, centre_mm: [0, 0, 20], radius_mm: 20, material: acrylic}\n"
LIBRARY = (
    "Input",
    "validation",
    "discriminator",
    "valid dictionary",
    "instance of",
    "valid string",
    "function-",
    "str.",
)


def problems(tmp_path, text):
    path = tmp_path / "scene.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_scene(path)
    assert not [word for word in LIBRARY if word in str(caught.value)], str(caught.value)
    return [(problem.line, problem.text) for problem in caught.value.problems]


def test_all_at_once_whatever_found_it(tmp_path):
    text = HEAD.replace("[1224, 1024]", "[1224]") + (
        GOOD
        + "  - {name: b, kind: sphere, centre_mm: [0, 0, 50], radius_mm: 20, material: acrilic}\n"
        + "  - {name: c, kind: ball, centre_mm: [90, 0, 20], radius_mm: 20, material: BK7}\n"
        + "  - {name: d, kind: sphere, centre_mm: [0, 0, 5e1], radius_mm: 20, material: [1]}\n"
        + "  - {name: e, kind: sphere, centre_mm: [0, 0, 25], radius_mm: 20, material: BK7}\n"  # overlaps a
        + "  - {name: f, kind: sphere, centre_mm: [0, 0, -25], radius_mm: 20, material: BK7}\n"  # legal
        + "  - 7\n"
    )
    found = problems(tmp_path, text)
    assert [line for line, _ in found] == [2, 5, 6, 7, 7, 8, 10]
    said = [sentence for _, sentence in found]
    assert said[0] == "camera.sensor_px: should have two entries, not 1"
    assert said[1].startswith("unknown medium 'acrilic'; did you mean 'acrylic'?")
    kinds = "'sphere', 'rod', 'window', 'tube', 'dome', 'mesh', 'box', 'prism'"
    assert said[2] == f"bodies.c.kind: should be one of {kinds}, not 'ball'"
    assert sorted(said[3:5])[1].startswith("bodies.d.material: should be text or a table")
    assert "overlap" in said[5]
    assert said[6].startswith("bodies.7: should be a table")


@loop_over(
    "old, new, sentence",
    [
        ("532", "green", "wavelength_nm: should be a number, not 'green'"),
        ("532", "'532'", "wavelength_nm: should be a number, not '532'; leave the quotes out"),
        ("532", "", "wavelength_nm: should be a number; nothing is given"),
        ("532", "5320", "wavelength_nm: should be 2000 or less, not 5320"),
        ("[1224, 1024]", "1224 x 1024", "camera.sensor_px: should be a list, as in [1.0, 2.0], not '1224 x 1024'"),
        ("[0, 0, 20]", "[0, 0]", "bodies.a.centre_mm: should have three entries, not 2"),
        ("kind: sphere, ", "", "bodies.a: key 'kind' is missing; it says what this is"),
        ("kind: sphere", "kind: Sphere", "'Sphere'; did you mean 'sphere'?"),
        ("acrylic", "{n: much}", "bodies.a.material.n: should be a number, not 'much'"),
        ("acrylic", "{N: 1.5}", "unknown key 'bodies.a.material.N'; did you mean 'n'?"),
        ("f_mm: 50, L_mm: 600, pixel_pitch_um: 3.45, sensor_px: [1224, 1024]", "basler", "unknown key"),
    ],
)
def test_words_for_each_kind_of_mistake(tmp_path, old, new, sentence):
    assert old in HEAD + GOOD
    found = problems(tmp_path, (HEAD + GOOD).replace(old, new, 1))
    assert [text for _, text in found if sentence in text], found


@pytest.mark.parametrize(
    ("camera", "sentence"),
    [
        ("look_at_mm: [0, 0, 1000]", "looks away from the investigation plane"),
        ("look_at_mm: [0, 900, 590]", "edge-on"),
        ("position_mm: [0, 0, -300]", "in front of the investigation plane"),
        ("position_mm: [0, 300, 600]", None),
    ],
)
def test_views_that_cannot_be(tmp_path, camera, sentence):
    text = HEAD.replace("1024]}", f"1024], {camera}}}") + GOOD
    if sentence is None:
        (tmp_path / "fine.yaml").write_text(text)
        assert load_scene(tmp_path / "fine.yaml").bodies
    else:
        (line, said), *more = problems(tmp_path, text)
        assert (line, more) == (2, [])
        assert sentence in said


def test_glass_behind_the_camera(tmp_path):
    ((line, said),) = problems(tmp_path, HEAD + GOOD.replace("[0, 0, 20]", "[0, 0, 900]"))
    assert line == 4
    assert "behind the camera" in said


@loop_over("said, meant",
    [("acrylic", "PMMA"), ("Plexiglas", "PMMA"), ("pmma", "PMMA"), ("BK7", "N-BK7"), ("bk 7", "N-BK7"),
     ("borosilicate", "borosilicate"), ("Duran", "borosilicate"), ("soda lime", "soda-lime"),
     ("Quartz", "fused-silica"), ("fused silica", "fused-silica"), ("Water", "water")],
)  # fmt: skip
def test_glass_by_its_common_names(said, meant):
    assert medium_called(said) is MEDIA[meant]
    own = MEDIA | {said: MEDIA["air"]}
    assert medium_called(said, own) is MEDIA["air"]  # what the file says itself wins


def test_a_fit_section_may_call_glass_as_people_do(tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_text(HEAD + GOOD + "fit: {glasses: {acrylic: 0.002}}\n")
    assert load_priors(path).glasses == {load_scene(path).spheres[0].medium.name: 0.002}
    path.write_text(HEAD + GOOD + "fit: {glasses: {acrilic: 0.002}}\n")
    with pytest.raises(ConfigError, match=r"scene.yaml:5: fit.glasses: there is no glass 'acrilic'"):
        load_priors(path)


@pytest.mark.parametrize(
    ("name", "nm", "n"),
    [("borosilicate", 587.56, 1.4714), ("borosilicate", 546.07, 1.4731), ("soda-lime", 587.56, 1.5233),
     ("soda-lime", 532.0, 1.5261), ("polystyrene", 587.56, 1.5916), ("polycarbonate", 587.56, 1.5848),
     ("water", 589.3, 1.33336)],
)  # fmt: skip
def test_indices_are_those_of_the_books(name, nm, n):
    assert MEDIA[name].n(nm) == pytest.approx(n, abs=3e-4)


def refusal(document, model):
    try:
        validate(document, model)
    except ConfigError as error:
        return str(error)
    return ""


def test_every_kind_of_problem_that_a_table_can_have_has_words():
    """Whatever value stands in place of any key of any file: no sentence of the library comes through."""
    strange = [None, True, -1, 1.5, "", "text", "5", [], [1], ["a", "b", "c"], {}, {"a": 1}, 10**30, float("inf")]
    for model in (SceneTable, BenchTable, PivTable, *map(plan_table, EXPERIMENTS)):
        schema = TypeAdapter(model).json_schema()
        for key in schema["properties"]:
            for value in strange:
                said = refusal(Document("file.yaml", {key: value}), model)
                assert not [word for word in LIBRARY if word in said], (model, key, value, said)


def test_a_list_where_a_file_should_be(tmp_path):
    (tmp_path / "list.yaml").write_text("- 1\n")
    with pytest.raises(ConfigError, match=r"the file: should be a table, as in \{key: value\}, not a list"):
        validate(open_document(tmp_path / "list.yaml"), SceneTable)
    assert plain_words.place_words({"a": [{"name": "x"}, 5]}, ("a", 1)) == "a.2"
