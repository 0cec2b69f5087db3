"""The site of `make docs`: every page in its index, and what is made from the program is whole."""

import dataclasses
import inspect
import re
import subprocess
import sys
from importlib import import_module

import pytest

from rtpiv.options import parser
from rtpiv.options.command import commands
from rtpiv.options.signature import signature
from tests.faces.test_faces import FACES
from tests.system.pages import DOCS, ROOT, SITE, prose

PARTS = ("Tutorial", "How to", "Reference", "Explanation")


@pytest.fixture
def made(monkeypatch):
    """A module of docs/made by its name."""
    monkeypatch.syspath_prepend(str(DOCS))
    return lambda name: import_module(f"made.{name}")


def listed(page):
    """Pages in the trees of contents of a page, in their order."""
    found = []
    for tree in re.findall(r"^```{toctree}\n(.*?)^```", page.read_text("utf-8"), re.MULTILINE | re.DOTALL):
        for line in filter(None, (line.strip() for line in tree.splitlines() if not line.startswith(":"))):
            found += sorted(page.parent.glob(f"{line}.md"))
            assert found, line
    return found


def test_every_page_stands_in_the_index_once_and_under_one_of_four_heads():
    index = DOCS / "index.md"
    reached = listed(index)
    for page in reached:  # grows
        reached += listed(page)
    assert sorted(reached) == sorted(set(SITE) - {index, ROOT / "README.md"})
    assert tuple(re.findall(r"^:caption: (.*)$", index.read_text("utf-8"), re.MULTILINE)) == PARTS


def test_a_page_has_one_title():
    for page in set(SITE) - {DOCS / "contributing.md"}:  # that is the file beside README
        titles = re.findall(r"^# .*$", prose(page), re.MULTILINE)
        assert len(titles) == 1, f"{page.name}: {titles}"


def test_decisions_are_numbered_in_one_row():
    pages = sorted((DOCS / "adr").glob("*.md"))
    titles = [re.match(r"# (\d+)\. ", page.read_text("utf-8"))[1] for page in pages]
    assert [int(page.name[:4]) for page in pages] == list(map(int, titles)) == list(range(1, len(pages) + 1))


def test_the_gallery_has_every_example_with_what_it_is(made):
    gallery = made("gallery")
    shown = {*gallery.scenes(), *gallery.others()}
    assert shown == {path for path in (ROOT / "examples").rglob("*") if path.suffix in (".yaml", ".py")}
    assert {"two_spheres_500.yaml", "body_centred_bed.yaml"} <= {path.name for path in gallery.scenes()}
    for path in shown:
        assert gallery.caption(path).endswith((".", ":")), path


def test_the_command_line_has_every_verb_with_every_option(made):
    text = made("command_line").text()
    parts = dict(re.findall(r"^## ([^\n]+)\n(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL))
    assert set(commands()) <= set(parts)
    for command, function in commands().items():
        options = re.findall(r"`(--[\w-]+)", parts[command])
        assert len(options) >= len([option for option in signature(function) if not option.is_word]), command
    assert "--dewarp-order" in parts["correct"]
    assert "`rtpiv correct FRAMES [FRAMES ...] --scene SCENE" in parts["correct"]
    assert len(parser().format_help()) < len(text)


def test_the_schemas_have_every_key_of_every_table(made):
    page = made("file_schemas")
    text = page.text()
    keys = set(re.findall(r"^`(\w+)`$", text, re.MULTILINE))
    for tables in page._files().values():
        for tree in tables.values():
            assert {
                key for table in (tree, *tree.get("$defs", {}).values()) for key in table["properties"]
            } <= keys
    places = re.findall(r"^\((\S+)\)=$", text, re.MULTILINE)
    assert len(places) == len(set(places))
    assert set(re.findall(r"\]\(#(\S+?)\)", text)) <= set(places)
    assert "`sensor_px`\n: list of 2: whole number, at least 1, at most 65535. Required." in text


def test_no_name_that_a_package_shows_and_no_value_it_gives_is_undocumented(made):
    text = made("python_names").text()
    found = made("python_names").names()
    assert set(found) >= {"rtpiv", *FACES}
    assert {value.__name__ for value in found["rtpiv"][1].values()} >= {"Traced", "SceneFit", "MeanFlow"}
    for package, (shown, given) in found.items():
        assert set(shown) == {f"{package}.{name}" for name in import_module(package).__all__}
        for name, thing in (shown | given).items():
            assert f":: {name}\n" in text
            if not callable(thing):  # a sentence of its package, see docs/made/python_names.py
                continue
            assert inspect.getdoc(thing), name
            assert inspect.getdoc(thing) != inspect.getdoc(type(thing)), name
            if inspect.isfunction(thing):
                told, takes = inspect.getdoc(thing), list(inspect.signature(thing).parameters)
            else:
                told = "\n".join(inspect.getdoc(each) for each in thing.__mro__)  # what a value has of another
                takes = (
                    [field.name for field in dataclasses.fields(thing)] if dataclasses.is_dataclass(thing) else []
                )
            for each in (each for each in takes if not each.startswith("_")):
                assert re.search(rf"^\**(\w+, )*{each}\b", told, re.MULTILINE), f"{name}: {each}"


def test_a_lost_link_of_the_site_is_found(made, tmp_path):
    (tmp_path / "there.html").write_text('<p id="place">')
    (tmp_path / "page.html").write_text(
        '<a href="there.html#place">good</a> <a href="https://example.org/">far</a>'
        '<a href="there.html#nowhere">1</a> <a href="gone.html">2</a> <img src="gone.png"> <a href="#below">3</a>'
    )
    lost = [line.partition(": ")[2] for line in made("links").broken(tmp_path)]
    assert lost == ["#below", "gone.html", "gone.png", "there.html#nowhere"]


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_the_site_is_built_without_a_warning_or_a_lost_link(tmp_path):
    pytest.importorskip("sphinx", reason="make docs installs what builds the site")
    pytest.importorskip("furo")
    for command in (
        [
            sys.executable,
            "-m",
            "sphinx",
            "-q",
            "-W",
            "--keep-going",
            "-d",
            tmp_path / "read",
            "docs",
            tmp_path / "html",
        ],
        [sys.executable, "docs/made/links.py", tmp_path / "html"],
    ):
        ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        assert ran.returncode == 0, ran.stdout + ran.stderr
    assert not (DOCS / "made" / "html").exists()
