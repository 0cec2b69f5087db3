"""Workflows, templates and citation as files: every target, path and version that they name is there."""

import glob
import re
import tomllib

import pytest

from ground.config import load_yaml
from tests.slow_suite import ROOT

WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
MAKEFILE = (ROOT / "Makefile").read_text("utf-8")
TARGETS = set(re.findall(r"^([a-z-]+):", MAKEFILE, re.MULTILINE))
VARIABLES = set(re.findall(r"^([A-Z]+) \?=", MAKEFILE, re.MULTILINE))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
MADE = ("dist", "htmlcov", "lab", "trace", "fit", "docs/_build")  # folders that a step makes
PATH = re.compile(r"(?<![\w/.$*-])((?:tests|docs|examples|rtpiv|\.github)/[\w/.-]+|[\w.-]+\.(?:txt|toml|cff|md))")


def steps(path):
    """Every step of a workflow, with its job."""
    for job in load_yaml(path).tree["jobs"].values():
        yield from ((job, step) for step in job["steps"])


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_every_target_variable_and_path_of_a_workflow_exists(path):
    text = path.read_text("utf-8")
    for _, step in steps(path):
        for call in re.findall(r"\bmake ([^\n]*)", step.get("run", "")):
            words = re.sub(r"\$\{\{.*?\}\}", "", call).split()
            targets = {word for word in words if re.fullmatch(r"[a-z-]+", word)}
            assert targets
            assert targets <= TARGETS, call
            assert set(re.findall(r"\b([A-Z]+)=", call)) <= VARIABLES, call
    named = PATH.findall(re.sub(r"#.*", "", text))
    there = [name for name in named if not name.startswith(MADE)]
    lacking = [name for name in there if not (ROOT / name.rstrip("/*")).exists()]
    assert not lacking
    for pattern in load_yaml(path).tree["on"].get("pull_request", None) or {}:
        assert pattern in ("paths", "branches")
        for each in load_yaml(path).tree["on"]["pull_request"][pattern]:
            assert glob.glob(str(ROOT / each), recursive=True), each  # noqa: PTH207


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_a_workflow_may_read_is_pinned_ends_and_names_no_address(path):
    tree = load_yaml(path).tree
    assert tree["permissions"] == {"contents": "read"}
    assert "://" not in path.read_text("utf-8")
    for job, step in steps(path):
        assert job["timeout-minutes"] <= 180
        assert "uses" in step or "run" in step
        if "uses" in step:
            assert re.fullmatch(r"[\w-]+/[\w-]+@(v\d+|release/v1)", step["uses"])
    allowed = [job["permissions"] for job in tree["jobs"].values() if "permissions" in job]
    assert allowed == ([{"id-token": "write"}] if path.stem == "release" else [])


def test_the_matrix_is_every_python_and_every_system():
    low, high = re.fullmatch(r">=3\.(\d+),<3\.(\d+)", PROJECT["requires-python"]).groups()
    pythons = [f"3.{minor}" for minor in range(int(low), int(high))]
    for name, job in (("tests", "fast"), ("release", "installed")):
        matrix = load_yaml(ROOT / f".github/workflows/{name}.yml").tree["jobs"][job]["strategy"]["matrix"]
        assert matrix["python-version"] == pythons
        assert [os.partition("-")[0] for os in matrix["os"]] == ["ubuntu", "windows", "macos"]


def test_a_citation_has_the_version():
    cited = load_yaml(ROOT / "CITATION.cff").tree
    assert (str(cited["version"]), cited["license"]) == (PROJECT["version"], PROJECT["license"])
