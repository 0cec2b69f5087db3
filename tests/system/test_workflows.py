"""Workflows, templates and citation as files: every target, path and version that they name is there."""

import glob
import re
import tomllib

import pytest

from ground.config import load_yaml
from tests.slow_suite import ROOT, SHARDS

WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
TEMPLATES = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"))
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


def test_there_are_workflows_for_tests_slow_tests_docs_coverage_and_releases():
    assert {path.stem for path in WORKFLOWS} == {"tests", "nightly", "docs", "coverage", "release"}


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


def test_every_shard_runs_at_night():
    job = load_yaml(ROOT / ".github/workflows/nightly.yml").tree["jobs"]["slow"]
    assert job["strategy"]["matrix"]["shard"] == list(range(1, SHARDS + 1))
    assert f"/{SHARDS}" in job["steps"][2]["run"]


def test_what_tests_run_is_what_make_runs():
    fast = re.search(r"^fast-tests:.*\n\t\$\(BIN\)/(.*)$", MAKEFILE, re.MULTILINE)[1]
    assert fast in [step.get("run") for _, step in steps(ROOT / ".github/workflows/tests.yml")]


def test_hooks_before_a_commit_are_those_of_lint():
    hooks = load_yaml(ROOT / ".pre-commit-config.yaml").tree["repos"][0]["hooks"]
    parts = re.search(r"^lint: (.*)$", MAKEFILE, re.MULTILINE)[1].split()
    rules = "".join(re.search(rf"^{part}:.*\n((?:\t.*\n)+)", MAKEFILE, re.MULTILINE)[1] for part in parts)
    tools = re.findall(r"\$\(BIN\)/([\w-]+)", rules)
    assert sorted(hook["entry"].removeprefix(".venv/bin/").split()[0] for hook in hooks) == sorted(tools)


def test_a_citation_has_the_version():
    cited = load_yaml(ROOT / "CITATION.cff").tree
    assert (str(cited["version"]), cited["license"]) == (PROJECT["version"], PROJECT["license"])


@pytest.mark.parametrize("path", TEMPLATES, ids=lambda path: path.stem)
def test_who_reports_is_asked_what_doctor_says(path):
    tree = load_yaml(path).tree
    if path.stem == "config":
        return
    asked = {field["id"]: field for field in tree["body"] if field["type"] != "markdown"}
    assert "`rtpiv doctor`" in asked["doctor"]["attributes"]["label"]
    assert asked["doctor"]["validations"]["required"] is True
