"""docs/python.md: the eight names, and a script whose every call is one that the functions take."""

import ast
import inspect
import re
from pathlib import Path

import rtpiv
from tests.rtpiv.test_face import VALUES

PAGE = Path(__file__).resolve().parents[2] / "docs" / "python.md"
README = PAGE.parents[1] / "README.md"


def script():
    block = re.search(r"((?:    .*\n|\n)*    from rtpiv import acquire(?:.*\n)(?:    .*\n|\n)+)", PAGE.read_text())
    return re.sub(r"(?m)^    ", "", block[1])


def test_the_table_names_the_eight():
    named = re.findall(r"^\| `(\w+)\(", PAGE.read_text(), re.MULTILINE)
    assert set(named) | {"ERRORS", *VALUES} == set(rtpiv.__all__)
    assert len(named) == 8


def test_the_script_is_short_and_its_calls_fit():
    tree = ast.parse(script())
    assert len([line for line in script().splitlines() if line.strip()]) <= 15
    called = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)]
    ours = [call for call in called if call.func.id in rtpiv.__all__]
    assert {call.func.id for call in ours} >= {"acquire", "calibrate", "correct", "evaluate", "report", "trace"}
    for call in ours:
        named = dict.fromkeys(keyword.arg for keyword in call.keywords)
        inspect.signature(getattr(rtpiv, call.func.id)).bind(*call.args, **named)
