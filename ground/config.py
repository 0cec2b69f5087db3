"""The YAML edge: a file becomes typed data, or every problem in it with its line.

YAML 1.1 is generous in ways that ruin experiments: a duplicate key silently wins, ``1e-3`` is text,
``on`` is True, ``010`` is eight and ``12:30`` is 750.  Here each of these is an error with file and line:

* duplicate keys, tags, merge keys, more than MAX_ALIASES aliases, files over MAX_BYTES,
* numbers that YAML would not read as the person meant them, NaN and infinity,
* unknown keys (a wrong unit suffix is an unknown key; the nearest known key is named), missing keys,
  values of the wrong type or outside their range.

Nothing is ever replaced by a default because it was wrong.  Scene, bench and plan files all come through
``read``.
"""

import difflib
import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ground.errors import ConfigError, Problem

MAX_BYTES = 1_000_000
MAX_ALIASES = 16
MAX_NODES = 50_000
MAX_DEPTH = 32

_NUMBER = re.compile(r"[-+]?(\d[\d_]*\.?[\d_]*|\.\d[\d_]*)([eE][-+]?\d+)?")
_INTEGER = re.compile(r"[-+]?(0|[1-9]\d*)")
_DECIMAL = re.compile(r"[-+]?(\d+\.\d*|\.\d+|\d+(?=[eE]))([eE][-+]?\d+)?")
_NOT_FINITE = re.compile(r"[-+]?\.?(inf|nan|infinity)", re.IGNORECASE)
_YES_NO = re.compile(r"(yes|no|on|off|y|n)", re.IGNORECASE)

Place = tuple[str | int, ...]
Triple = Annotated[list[float], Field(min_length=3, max_length=3)]
Pair = Annotated[list[float], Field(min_length=2, max_length=2)]


class Table(BaseModel):
    """Base of every part of a file: no unknown keys, no silent conversion, no NaN."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


Model = TypeVar("Model", bound=Table)


@dataclass
class Document:
    """A YAML file as plain data, with the line of every place in it."""

    path: Path
    tree: Any
    lines: dict[Place, int] = field(default_factory=dict)

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
    path = Path(path)
    try:
        with path.open("rb") as stream:
            raw = stream.read(MAX_BYTES + 1)  # never more, whatever the file claims to be
    except (OSError, ValueError) as error:
        raise ConfigError(
            path, [Problem(0, f"cannot be read: {getattr(error, 'strerror', None) or error}")]
        ) from None
    if len(raw) > MAX_BYTES:
        raise ConfigError(path, [Problem(0, f"is larger than the {MAX_BYTES} bytes allowed")])
    try:
        root = yaml.compose(raw.decode("utf-8"), _BoundedLoader)
    except UnicodeDecodeError:
        raise ConfigError(path, [Problem(0, "is not UTF-8 text")]) from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else 0
        prefix = "" if isinstance(error, _OutOfBounds) else "is not valid YAML: "
        raise ConfigError(path, [Problem(line, f"{prefix}{error.problem or error.context}")]) from None
    except yaml.YAMLError as error:
        raise ConfigError(path, [Problem(0, f"is not valid YAML: {str(error).splitlines()[0]}")]) from None
    if root is None:
        raise ConfigError(path, [Problem(1, "is empty")])
    reader = _Reader()
    tree = reader.value(root, ())
    if reader.problems:
        raise ConfigError(path, reader.problems)
    return Document(path, tree, reader.lines)


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
            self._stop("is nested too deeply or holds too many values")
        self.depth += 1
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def _stop(self, problem: str) -> None:
        raise _OutOfBounds(problem=problem, problem_mark=self.peek_event().start_mark)


class _Reader:
    """Turns YAML nodes into plain data, collecting problems instead of stopping at the first."""

    def __init__(self) -> None:
        self.problems: list[Problem] = []
        self.lines: dict[Place, int] = {}
        self.nodes = 0

    def value(self, node: yaml.Node, place: Place) -> Any:  # noqa: ANN401 - YAML holds anything
        line = node.start_mark.line + 1
        self.lines.setdefault(place, line)
        self.nodes += 1
        if self.nodes > MAX_NODES or len(place) > MAX_DEPTH:
            if self.nodes <= MAX_NODES or not self.problems:
                self.problems.append(Problem(line, "is nested too deeply or holds too many values"))
            return None
        if isinstance(node, yaml.MappingNode):
            return self._mapping(node, place)
        if isinstance(node, yaml.SequenceNode):
            return [self.value(item, (*place, index)) for index, item in enumerate(node.value)]
        return self._scalar(node, line)

    def _mapping(self, node: yaml.MappingNode, place: Place) -> dict[str, Any]:
        result: dict[str, Any] = {}
        for key_node, value_node in node.value:
            line = key_node.start_mark.line + 1
            if not isinstance(key_node, yaml.ScalarNode) or key_node.tag == "tag:yaml.org,2002:merge":
                self.problems.append(Problem(line, "keys must be plain words; merge keys are not supported"))
                continue
            key = str(key_node.value)
            if key in result:
                first = self.lines[(*place, key)]
                self.problems.append(Problem(line, f"key {key!r} is already given in line {first}"))
                continue
            self.lines[(*place, key)] = line
            result[key] = self.value(value_node, (*place, key))
        return result

    def _scalar(self, node: yaml.Node, line: int) -> str | int | float | bool | None:
        text = str(node.value)
        if node.tag not in _PLAIN_TAGS:
            self.problems.append(Problem(line, f"tag {node.tag!r} is not supported; remove it"))
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
        self._refuse_doubtful(text, node.tag, line)
        return text

    def _refuse_doubtful(self, text: str, tag: str, line: int) -> None:
        """Report plain text that a person may have meant as something else."""
        if _NOT_FINITE.fullmatch(text):
            self.problems.append(Problem(line, f"{text!r} is not a finite number"))
        elif _NUMBER.fullmatch(text):
            cure = "with a decimal point, as in 1.0e-3, and without leading zeros or underscores"
            self.problems.append(Problem(line, f"{text!r} is text to YAML; write the number {cure}"))
        elif _YES_NO.fullmatch(text) and tag == "tag:yaml.org,2002:bool":
            self.problems.append(Problem(line, f"{text!r} is ambiguous; write true or false, or quote the word"))
        elif tag != "tag:yaml.org,2002:str":
            self.problems.append(Problem(line, f"{text!r} is ambiguous in YAML; quote it if it is text"))


_PLAIN_TAGS = {
    f"tag:yaml.org,2002:{kind}" for kind in ("str", "int", "float", "bool", "null", "timestamp", "value")
}


def validate(document: Document, model: type[Model]) -> Model:
    """Check a document against a model.

    Raises
    ------
    ConfigError
        Everything that does not fit, with the lines.
    """
    try:
        return model.model_validate(document.tree)
    except ValidationError as error:
        problems = [
            Problem(document.line(place), _sentence(document, model, place, details))
            for details in error.errors(include_url=False)
            for place in [_place(document, details["loc"])]
        ]
        raise ConfigError(document.path, problems) from None


def read(path: Path | str, model: type[Model]) -> Model:
    """Read and check a YAML file: `load_yaml`, then `validate`."""
    return validate(load_yaml(path), model)


def _place(document: Document, loc: tuple[str | int, ...]) -> Place:
    """Error location without the names of union members that pydantic puts between keys."""
    place: Place = ()
    for index, part in enumerate(loc):
        if (*place, part) in document.lines or index == len(loc) - 1:
            place = (*place, part)
    return place


def _sentence(document: Document, model: type[Table], place: Place, details: Any) -> str:  # noqa: ANN401
    name = ".".join(str(part) for part in place) or "file"
    kind, message = details["type"], str(details["msg"])
    if kind == "extra_forbidden":
        others = [
            key for key in _known_keys(model) if key != place[-1]
        ]  # a known key may stand in the wrong place
        near = difflib.get_close_matches(str(place[-1]), others, n=1, cutoff=0.6)
        return f"unknown key {name!r}" + (f"; did you mean {near[0]!r}?" if near else "")
    if kind == "missing":
        return f"key {name!r} is missing"
    message = message.removeprefix("Value error, ").removeprefix("Input should be ")
    got = details.get("input")
    shown = "" if isinstance(got, dict | list) or got is None else f", not {got!r}"
    return f"{name}: {message if kind == 'value_error' else 'should be ' + message + shown}"


def _known_keys(model: type[Table]) -> list[str]:
    """Every key of a model and of the models below it."""
    keys: set[str] = set()
    definitions = model.model_json_schema()
    for schema in [definitions, *definitions.get("$defs", {}).values()]:
        keys.update(schema.get("properties", {}))
    return sorted(keys)
