"""Options of a verb, read from its source: signature and docstring are the only place that declares them.

    def correct(frames: Sequence[Named], /, scene: Named, out: Named | None = None, ...)

Parameters before the slash are positional, all others are options: required without a default, ``--no-x`` for a
flag that is on.  The type selects the reader (`rtpiv.options.numbers`); a Literal gives choices, a sequence
several values; the help is the description under "Parameters".  A parameter whose type is a frozen dataclass, or
typed keywords (``**options: Unpack[T]``), gives an option for each field; a flag that may be such a value
(``simulate: bool | Rehearsal``) gives both, and is that value where one of its fields is given.

No verb is imported, as verbs need compiled kernels and ``--help`` has to answer at once (ADR 49): names are
followed through the sources instead, from module to module.
"""

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

HOME = Path(__file__).resolve().parents[2]  # of our packages
VERBS = "rtpiv.verbs"
READERS = {"str": "str", "int": "whole", "float": "finite", "Path": "Path", "bool": "bool"}
SEQUENCES = ("Sequence", "list", "tuple")
REQUIRED = object()
FOR_PYTHON = re.compile(r"None$|Sequence\[Mapping\b")  # types without words on the command line
AS_OF = re.compile(r"As (?:for|of) (?:the verb )?`(\w+)`")


@dataclass(frozen=True)
class Kind:
    """Reading of the words of an option.

    Parameters
    ----------
    read : str
        Name of the reader: of `rtpiv.options.numbers`, "str", "Path" or "bool".
    many : int or str, optional
        Number of words, "+" for any.
    choices : tuple, optional
        Allowed values.
    """

    read: str
    many: int | str | None = None
    choices: tuple[Any, ...] | None = None


@dataclass(frozen=True)
class ValueClass:
    """A class whose fields are options.

    Parameters
    ----------
    module, name : str
        Where it is.
    keywords : bool
        Its fields are keywords of the verb, not of a value.
    """

    module: str
    name: str
    keywords: bool = False


@dataclass(frozen=True)
class Option:
    """One word or option of a verb.

    Parameters
    ----------
    name : str
        Of the parameter, or of the field of a value.
    kind : Kind
        Reading of its words.
    default : object
        Value if it is not given; REQUIRED if it must be.
    help : str
        Description.
    is_word : bool
        It is positional.
    holder : str
        Name of the parameter that is a value with this field; empty for a parameter itself.
    of : ValueClass, optional
        The class of that value.
    """

    name: str
    kind: Kind
    default: Any
    help: str
    is_word: bool = False
    holder: str = ""
    of: ValueClass | None = None


def title(value: ValueClass) -> str:
    """Return the topic of a class of options: the first line of its docstring."""
    statement = _top(value.module)[value.name]
    assert isinstance(statement, ast.ClassDef)
    return _plain((ast.get_docstring(statement) or "").split("\n")[0]).rstrip(".")


def summary(verb: str) -> str:
    """Return the purpose of a verb: the first line of its module."""
    with (HOME / VERBS.replace(".", "/") / f"{verb}.py").open(encoding="utf-8") as file:
        return _plain(file.readline().partition(": ")[2].strip().strip('"')).rstrip(".")


@cache
def signature(verb: str) -> tuple[Option, ...]:
    """Read the options of a verb.

    Parameters
    ----------
    verb : str
        Its name: a function of this name in a module of this name.

    Returns
    -------
    tuple of Option
        Its words and options, in their order.
    """
    module = f"{VERBS}.{verb}"
    function = _top(module)[verb]
    assert isinstance(function, ast.FunctionDef)
    taken = function.args
    every = [*taken.posonlyargs, *taken.args, *taken.kwonlyargs]
    several = len(taken.posonlyargs) + len(taken.args)
    defaults = [None] * (several - len(taken.defaults)) + list(taken.defaults) + list(taken.kw_defaults)
    said, found = _descriptions(module, verb), list[Option]()
    for number, (one, default) in enumerate(zip(every, defaults, strict=True)):
        assert one.annotation is not None
        kind = _kind(one.annotation, module)
        if isinstance(kind, ValueClass):
            found += _fields(kind, one.arg)
        else:
            value = REQUIRED if default is None else _value(default, module)
            help_text = said.get(one.arg, "")
            found.append(Option(one.arg, kind, value, help_text, number < len(taken.posonlyargs)))
            if kind.read == "bool" and isinstance(one.annotation, ast.BinOp):
                beside = _kind(one.annotation.right, module)
                assert isinstance(beside, ValueClass)
                found += _fields(beside, one.arg)
    if taken.kwarg is not None:
        assert isinstance(taken.kwarg.annotation, ast.Subscript)  # Unpack[T]
        kind = _kind(taken.kwarg.annotation.slice, module)
        assert isinstance(kind, ValueClass)
        found += _fields(replace(kind, keywords=True), taken.kwarg.arg)
    return tuple(found)


def _fields(value: ValueClass, holder: str) -> Iterator[Option]:
    """Yield the options of the fields of a class; typed keywords are all optional."""
    body, said = _top(value.module)[value.name], _descriptions(value.module, value.name)
    assert isinstance(body, ast.ClassDef)
    for field in body.body:
        if not (isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)):
            continue
        kind, name = _kind(field.annotation, value.module), field.target.id
        assert isinstance(kind, Kind), f"{value.name}.{name}: a value within a value is no option"
        default = None if value.keywords else REQUIRED
        if field.value is not None:
            default = _value(field.value, value.module)
        yield Option(name, kind, default, said.get(name, ""), False, holder, value)


@cache
def _top(module: str) -> dict[str, ast.stmt]:
    """Return the statements that define the names of a module."""
    place = HOME / module.replace(".", "/")
    path = place.with_suffix(".py") if place.with_suffix(".py").is_file() else place / "__init__.py"
    found: dict[str, ast.stmt] = {}
    for statement in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(statement, ast.FunctionDef | ast.ClassDef):
            found[statement.name] = statement
        elif isinstance(statement, ast.Assign):
            for target in statement.targets:
                for name in [target, *getattr(target, "elts", ())]:
                    if isinstance(name, ast.Name):
                        found[name.id] = statement
        elif isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name):
            found[statement.target.id] = statement
        elif isinstance(statement, ast.ImportFrom):
            found |= {name.asname or name.name: statement for name in statement.names}
    return found


def _home(name: str, module: str) -> tuple[ast.stmt, str]:
    """Return the statement that defines a name, and its module: imports are followed."""
    while isinstance(statement := _top(module)[name], ast.ImportFrom):
        assert statement.module is not None
        name = next(alias.name for alias in statement.names if (alias.asname or alias.name) == name)
        module = statement.module
    return statement, module


def _kind(node: ast.expr, module: str) -> Kind | ValueClass:
    """Return the reading of a type."""
    if isinstance(node, ast.BinOp):  # a | b: one word, or several; a scene in memory is for Python alone
        words = [side for side in (node.left, node.right) if not FOR_PYTHON.match(ast.unparse(side))]
        sides = [_kind(side, module) for side in words]
        kinds = [side for side in sides if isinstance(side, Kind)]
        kinds.sort(key=lambda kind: (kind.many is None, kind.read != "Path"))
        return kinds[0] if kinds else sides[0]
    if isinstance(node, ast.Constant):
        return _kind(ast.parse(str(node.value), mode="eval").body, module)
    if isinstance(node, ast.Subscript):
        return _kind_of_subscript(node, module)
    assert isinstance(node, ast.Name), ast.unparse(node)
    if node.id in READERS:
        return Kind(READERS[node.id])
    statement, home = _home(node.id, module)
    if isinstance(statement, ast.ClassDef):
        return ValueClass(home, statement.name)
    assert isinstance(statement, ast.Assign | ast.AnnAssign)
    assert statement.value is not None
    return _kind(statement.value, home)


def _kind_of_subscript(node: ast.Subscript, module: str) -> Kind | ValueClass:
    """Return the reading of a generic type."""
    name = ast.unparse(node.value)
    parts = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
    if name == "Literal":
        choices = tuple(_value(part, module) for part in parts)
        return Kind("whole" if isinstance(choices[0], int) else "str", None, choices)
    one = _kind(parts[0], module)
    if isinstance(one, ValueClass):
        return one
    if name == "Annotated":
        return replace(one, read=parts[1].id, many=None) if isinstance(parts[1], ast.Name) else one
    assert name in SEQUENCES, ast.unparse(node)
    fixed = name == "tuple" and ast.unparse(parts[-1]) != "..."
    return replace(one, many=len(parts) if fixed else "+")


def _value(node: ast.expr, module: str) -> Any:  # noqa: ANN401 - whatever the default is
    """Return the value of a default."""
    if isinstance(node, ast.Name):
        statement, home = _home(node.id, module)
        assert isinstance(statement, ast.Assign | ast.AnnAssign)
        assert statement.value is not None
        return _value(statement.value, home)
    if isinstance(node, ast.Call) and ast.unparse(node.func) == "Path":
        return Path(*(_value(argument, module) for argument in node.args))
    return ast.literal_eval(node)


@cache
def _descriptions(module: str, name: str) -> dict[str, str]:
    """Return the description of each parameter or field, from the docstring."""
    statement = _top(module)[name]
    assert isinstance(statement, ast.FunctionDef | ast.ClassDef)
    said: dict[str, list[str]] = {}
    lines, names = (ast.get_docstring(statement) or "").split("\n"), list[str]()
    start = lines.index("Parameters") + 2 if "Parameters" in lines else len(lines)
    for number in range(start, len(lines)):
        line = lines[number]
        if lines[number + 1 : number + 2] == ["-" * len(line)] and line:  # the next section
            break
        if line and not line.startswith(" "):
            names = [each.strip("* ") for each in line.partition(" : ")[0].split(",")]
        for each in names if line.startswith(" ") else ():
            said.setdefault(each, []).append(line.strip())
    return {each: _follow_reference(each, " ".join(text), name) for each, text in said.items()}


def _follow_reference(name: str, text: str, verb: str) -> str:
    """Return a description without markup; one that refers to another verb is taken from there."""
    if (
        (there := AS_OF.match(text))
        and there[1] != verb
        and (HOME / VERBS.replace(".", "/") / f"{there[1]}.py").is_file()
    ):
        for option in signature(there[1]):
            if option.name == name:
                return option.help
    return _plain(text)


def _plain(text: str) -> str:
    return text.replace("``", "").replace("`", "")
