"""The YAML edge: a file becomes typed data, or every problem in it with its line.

YAML 1.1 is generous in ways that ruin experiments: a duplicate key silently wins, ``1e-3`` is text,
``on`` is True, ``010`` is eight and ``12:30`` is 750.  Here each of these is an error with file and line:

* duplicate keys, tags, merge keys, more than MAX_ALIASES aliases, files over MAX_BYTES, texts over MAX_TEXT,
  characters that cannot be printed (they would be commands to the terminal that shows the name),
* numbers that YAML would not read as the person meant them, NaN and infinity,
* unknown keys (a wrong unit suffix is an unknown key; the nearest known key is named), missing keys,
  values of the wrong type or outside their range.

Nothing is ever replaced by a default because it was wrong, and what is wrong is reported at once, in the words of
``plain_words``.  Scene, bench and plan files all come through ``read``.
"""

import math
import re
from collections import defaultdict
from collections.abc import Container
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ground.errors import ConfigError, Problem
from ground.plain_file import read_plain
from ground.plain_words import NAME_PATTERN, exactly, is_of_a_kind, place_words, sentence

MAX_BYTES = 1_000_000
MAX_ALIASES = 16
MAX_NODES = 50_000
MAX_DEPTH = 32
MAX_NAME = 100  # characters of a key
MAX_TEXT = 4096  # characters of a text: the longest path

_NUMBER = re.compile(r"[-+]?(\d[\d_]*\.?[\d_]*|\.\d[\d_]*)([eE][-+]?\d+)?")
_INTEGER = re.compile(r"[-+]?(0|[1-9]\d*)")
_DECIMAL = re.compile(r"[-+]?(\d+\.\d*|\.\d+|\d+(?=[eE]))([eE][-+]?\d+)?")
_NOT_FINITE = re.compile(r"[-+]?\.?(inf|nan|infinity)", re.IGNORECASE)
_YES_NO = re.compile(r"(yes|no|on|off|y|n)", re.IGNORECASE)

KINDS = {"experiment": "plan", "stages": "bench", "bodies": "scene"}  # by a key that only files of a kind have
Place = tuple[str | int, ...]
Triple = Annotated[list[float], Field(min_length=3, max_length=3), exactly(3)]
Name = Annotated[str, Field(pattern=NAME_PATTERN)]
Pair = Annotated[list[float], Field(min_length=2, max_length=2), exactly(2)]


class Table(BaseModel):
    """Base of every part of a file: no unknown keys, no silent conversion, no NaN.

    What reads it is built when a file has such a part: a command that reads a scene does not wait for benches.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False, defer_build=True)


Model = TypeVar("Model", bound=Table)


@dataclass
class Document:
    """A YAML file as plain data, with the line of every place in it.

    `ambiguous` are places whose value YAML reads as something else than it looks like; `validate` reports them
    with all other problems.
    """

    path: Path
    tree: Any
    lines: dict[Place, int] = field(default_factory=dict)
    ambiguous: dict[Place, Problem] = field(default_factory=dict)

    def inside(self, *place: str | int) -> "Document":
        """Return a part as a document of its own, with the lines of the file."""
        tree = self.tree
        for part in place:
            tree = tree[part]
        lines = {at[len(place) :]: line for at, line in self.lines.items() if at[: len(place)] == place}
        return Document(self.path, tree, lines)

    def line(self, place: Place) -> int:
        """Line of a place in the tree, or of the nearest place around it that exists."""
        for end in range(len(place), -1, -1):
            if place[:end] in self.lines:
                return self.lines[place[:end]]
        return 1


def load_yaml(path: Path | str) -> Document:
    """Read a YAML file strictly.

    Parameters
    ----------
    path : path
        The file.

    Returns
    -------
    Document
        Plain dicts, lists, strings, numbers, booleans and None, with line numbers.

    Raises
    ------
    ConfigError
        The file is missing, too large, not UTF-8, not YAML, or uses what this module refuses.
    """
    document = open_document(path)
    if document.ambiguous:
        raise ConfigError(document.path, list(document.ambiguous.values()))
    return document


def open_document(path: Path | str) -> Document:
    """Read a YAML file as `load_yaml` does, and leave ambiguous values to `validate`.

    Raises
    ------
    ConfigError
        The file is missing, too large, not UTF-8, not YAML, or too deep to be read to its end.
    """
    path = Path(path)
    try:
        raw = read_plain(path, MAX_BYTES)
    except OSError as error:
        raise ConfigError(path, [Problem(0, f"cannot be read: {error.strerror or error}")]) from None
    try:
        root = yaml.compose(raw.decode("utf-8"), _BoundedLoader)
    except UnicodeDecodeError:
        raise ConfigError(path, [Problem(0, "is not UTF-8 text; save it as UTF-8 in your editor")]) from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else 0
        prefix = "" if isinstance(error, _OutOfBounds) else "is not valid YAML: "
        said = str(error.problem or error.context)
        if "cannot start any token" in said and b"\t" in raw:
            said += "; indent with spaces, not with tabs"
        raise ConfigError(path, [Problem(line, f"{prefix}{said}")]) from None
    except yaml.YAMLError as error:
        raise ConfigError(path, [Problem(0, f"is not valid YAML: {str(error).splitlines()[0]}")]) from None
    if root is None:
        raise ConfigError(path, [Problem(1, "is empty")])
    reader = _Reader()
    tree = reader.value(root, ())
    if reader.is_too_much:
        raise ConfigError(path, list(reader.problems.values()))
    return Document(path, tree, reader.lines, reader.problems)


_TOO_MUCH = f"is nested too deeply (at most {MAX_DEPTH} levels) or holds too many values (at most {MAX_NODES})"


class _OutOfBounds(yaml.MarkedYAMLError):
    """The file asks for more than any honest file needs."""


class _BoundedLoader(yaml.composer.Composer, getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """Composes nodes one by one and stops at the first bound, before time or memory are gone.

    Events come from libyaml where PyYAML was built with it: 30 times as fast, so that the bounds end a file in a
    second and not in half a minute.
    """

    def __init__(self, stream: str) -> None:
        yaml.composer.Composer.__init__(self)
        super(yaml.composer.Composer, self).__init__(stream)
        self.nodes = self.aliases = self.depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Compose one node, counting."""
        self.nodes += 1
        self.aliases += self.check_event(yaml.AliasEvent)
        if self.aliases > MAX_ALIASES:
            self._stop(f"uses more than {MAX_ALIASES} aliases; write the values out")
        if self.nodes > MAX_NODES or self.depth > MAX_DEPTH:
            self._stop(_TOO_MUCH)
        self.depth += 1
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def _stop(self, problem: str) -> None:
        raise _OutOfBounds(problem=problem, problem_mark=self.peek_event().start_mark)


class _Reader:
    """Turns YAML nodes into plain data, collecting problems instead of stopping at the first."""

    def __init__(self) -> None:
        self.problems: dict[Place, Problem] = {}
        self.lines: dict[Place, int] = {}
        self.nodes = 0
        self.is_too_much = False

    def value(self, node: yaml.Node, place: Place) -> Any:  # noqa: ANN401 - YAML holds anything
        line = node.start_mark.line + 1
        self.lines.setdefault(place, line)
        self.nodes += 1
        if self.nodes > MAX_NODES or len(place) > MAX_DEPTH:
            if not self.is_too_much:
                self.problems[place] = Problem(line, _TOO_MUCH)
            self.is_too_much = True
            return None
        if isinstance(node, yaml.MappingNode):
            return self._mapping(node, place)
        if isinstance(node, yaml.SequenceNode):
            return [self.value(item, (*place, index)) for index, item in enumerate(node.value)]
        return self._scalar(node, place)

    def _mapping(self, node: yaml.MappingNode, place: Place) -> dict[str, Any]:
        result: dict[str, Any] = {}
        for number, (key_node, value_node) in enumerate(node.value):
            line = key_node.start_mark.line + 1
            if number and (slip := _decimal_comma(node.value[number - 1], (key_node, value_node))):
                self.problems[(*place, f"line {line}", slip)] = Problem(line, slip)
                continue
            if not isinstance(key_node, yaml.ScalarNode) or key_node.tag == "tag:yaml.org,2002:merge":
                text = "keys must be plain words; merge keys are not supported"
                self.problems[(*place, f"line {line}")] = Problem(line, text)
                continue
            key = str(key_node.value)
            if not self._is_sayable(key, MAX_NAME, (*place, f"line {line}"), line):
                continue
            if key in result:
                first = self.lines[(*place, key)]
                text = f"key {key!r} is already given in line {first}"
                self.problems[(*place, f"line {line}", key)] = Problem(line, text)
                continue
            self.lines[(*place, key)] = line
            result[key] = self.value(value_node, (*place, key))
        return result

    def _is_sayable(self, text: str, longest: int, place: Place, line: int) -> bool:
        """Return whether a text can be shown and named after; what cannot is a problem."""
        if len(text) > longest:
            said = f"a text of {len(text)} characters; at most {longest} are read"
        elif not text.replace("\n", "").replace("\t", "").isprintable():
            said = f"{text[:MAX_NAME]!r} holds characters that cannot be printed"
        else:
            return True
        self.problems[place] = Problem(line, said)
        return False

    def _scalar(self, node: yaml.Node, place: Place) -> str | int | float | bool | None:
        text = str(node.value)
        if not self._is_sayable(text, MAX_TEXT, place, node.start_mark.line + 1):
            return None
        if node.tag not in _PLAIN_TAGS:
            line = node.start_mark.line + 1
            self.problems[place] = Problem(line, f"tag {node.tag!r} is not supported; remove it")
            return None
        if getattr(node, "style", None):  # quoted: text, whatever it looks like
            return text
        if text in ("", "~", "null"):
            return None
        if text in ("true", "false"):
            return text == "true"
        if _INTEGER.fullmatch(text):
            return int(text) if len(text) < 20 else float(text)
        if _DECIMAL.fullmatch(text) and math.isfinite(float(text)) and "." in text:
            return float(text)
        if said := _second_reading(text, node.tag):
            self.problems[place] = Problem(node.start_mark.line + 1, said)
        return text


def _decimal_comma(before: tuple[yaml.Node, yaml.Node], pair: tuple[yaml.Node, yaml.Node]) -> str:
    """Say what is wrong where ``{f_mm: 20,5}`` has been read as f_mm: 20 and a key 5 without a value; else ""."""
    (name, value), (key, empty) = before, pair
    if not (isinstance(key, yaml.ScalarNode) and isinstance(empty, yaml.ScalarNode) and empty.value == ""):
        return ""
    if not (str(key.value).isdecimal() and str(value.value).lstrip("+-").isdecimal()):
        return ""
    said = f"{value.value},{key.value}"
    return f"{name.value}: {said}: a decimal comma? write a decimal point: {said.replace(',', '.')}"


def _second_reading(text: str, tag: str) -> str | None:
    """Reason why plain text may be meant as something else; None if there is none."""
    if _NOT_FINITE.fullmatch(text):
        return f"{text!r} is not a finite number"
    if _NUMBER.fullmatch(text):
        cure = "with a decimal point, as in 1.0e-3, and without leading zeros or underscores"
        return f"{text!r} is text to YAML; write the number {cure}"
    if _YES_NO.fullmatch(text) and tag == "tag:yaml.org,2002:bool":
        return f"{text!r} is ambiguous; write true or false, or quote the word"
    if tag != "tag:yaml.org,2002:str":
        return f"{text!r} is ambiguous in YAML; quote it if it is text"
    return None


_PLAIN_TAGS = {
    f"tag:yaml.org,2002:{kind}" for kind in ("str", "int", "float", "bool", "null", "timestamp", "value")
}


def validate(document: Document, model: type[Model]) -> Model:
    """Check a document against a model.

    Raises
    ------
    ConfigError
        Everything that does not fit, with the lines; of a file of another kind only that.
    """
    require_kind(document, model.model_fields)
    problems, found = list(document.ambiguous.values()), None
    try:
        found = model.model_validate(document.tree)
    except ValidationError as error:
        by_place: dict[Place, list[Any]] = defaultdict(list)
        for details in error.errors(include_url=False):
            by_place[_place(document, details)].append(details)
        problems += [
            Problem(document.line(place), _words(document, model, place, several))
            for place, several in by_place.items()
            if place not in document.ambiguous and not _is_other_branch(document, place, several, by_place)
        ]
    if found is None or problems:
        raise ConfigError(document.path, problems)
    return found


def require_kind(document: Document, keys: Container[str]) -> None:
    """Refuse a bench where a scene is wanted, and so on, by one sentence; `keys` are those of the kind wanted."""
    tree = document.tree if isinstance(document.tree, dict) else {}
    wanted, given = ([KINDS[key] for key in KINDS if key in some] for some in (keys, tree))
    if wanted and given and wanted[0] not in given:
        named = [tree.get(kind) for kind in wanted]  # a bench names its scene
        cure = f", and {named[0]} beside it is one" if isinstance(named[0], str) else ""
        text = f"this is a {given[0]} file; a {wanted[0]} file is wanted here{cure}"
        raise ConfigError(document.path, [Problem(0, text)])


def read(path: Path | str, model: type[Model]) -> Model:
    """Read and check a YAML file: `open_document`, then `validate`."""
    return validate(open_document(path), model)


def _place(document: Document, details: Any) -> Place:  # noqa: ANN401 - as the library has it
    """Place of a problem, without the names of union members that the library puts between keys."""
    place: Place = ()
    loc, tree = details["loc"], document.tree
    for index, part in enumerate(loc):
        there = part in tree if isinstance(tree, dict) else isinstance(tree, list) and part in range(len(tree))
        if there:
            tree = tree[part]
        if there or (details["type"] == "missing" and index == len(loc) - 1):
            place = (*place, part)
    return place


def _is_other_branch(
    document: Document, place: Place, several: list[Any], by_place: dict[Place, list[Any]]
) -> bool:
    """Return whether a value was only not the other thing it might have been: what is wrong lies deeper in it."""
    deeper = any(len(other) > len(place) and other[: len(place)] == place for other in by_place)
    return deeper and all(is_of_a_kind(details) for details in several)


def _words(document: Document, model: type[Table], place: Place, several: list[Any]) -> str:
    return sentence(place_words(document.tree, place), several, lambda: _keys_of(model))


def _keys_of(model: type[Table]) -> list[str]:
    """Every key of a model and of the models below it."""
    keys: set[str] = set()
    definitions = model.model_json_schema()
    for schema in [definitions, *definitions.get("$defs", {}).values()]:
        keys.update(schema.get("properties", {}))
    return sorted(keys)
