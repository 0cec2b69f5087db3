"""Size and wording of the code, counted and held below `budget.toml` by `tests/system/test_budget.py`.

    python -m tests.budget                     # every row beside its budget
    python -m tests.budget participle_names    # the places that a row counts
    python -m tests.budget --lower             # write today's count into every row that has fallen

Code lines hold no comment, blank line or docstring. All rows but those of code lines count the packages alone.
A budget is raised by hand, with an ADR that says what is bought (docs/adr/0048-a-budget-of-lines-and-words.md).
"""

import ast
import io
import re
import sys
import tokenize
import tomllib
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from rtpiv.options.command import VERBS

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / "tests" / "budget.toml"
PACKAGES = ("ground", "tracer", "piv", "correction", "stages", "daq", "sim", "rtpiv")
MAX_ARGUMENTS, MAX_FILE_LINES = 8, 500
LIMIT = "characters_per_code_line"  # an average, which is bounded and need not fall
DIALECT = re.compile(r"\b(?:told|nobody|whoever|aslant|doubt\w*|books|somebody|anybody)\b", re.IGNORECASE)
CLAUSES = {"What", "Who", "Whose", "How", "Which", "Where", "Why", "When", "Whether"}
ENDS_IN_ED = re.compile(
    r"(?!(?:need|speed|seed|feed|embed|shed|bed|red|exceed|proceed|succeed|bleed|breed)$)[a-z]+ed"
)
IRREGULAR = re.compile(
    "said|shown|known|held|seen|found|left|made|drawn|told|taken|given|kept|sent|written|lost|thrown|begun|bent|"
    "built|chosen|done|fallen|gone|hidden|laid|led|met|paid|sold|spent|stood|sunk|swept|thought|understood|won|worn|"
    "apart|together|alike|alone"
)
NOT_CODE = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER,
}  # fmt: skip
Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass
class Count:
    """Rows of the budget, and the places behind those that count places."""

    code_lines: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    places: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    functions: int = 0
    docstrings: int = 0
    characters: int = 0

    @property
    def rows(self) -> dict[str, float]:
        """Value of every row."""
        package_lines = sum(self.code_lines[package] for package in PACKAGES)
        return {
            **self.code_lines,
            **{name: len(self.places[name]) for name in PLACES},
            LIMIT: round(self.characters / package_lines, 1),
            "verbs": len(VERBS),
        }

    def share(self, name: str) -> str:
        """Percentage that goes with a row, or an empty text."""
        whole = {"participle_names": self.functions, "docstring_heads": self.docstrings}.get(name)
        return f"{100 * len(self.places[name]) / whole:8.1f} %" if whole else ""


PLACES = (
    "functions_above_8_arguments", "kernels_above_8_arguments", "participle_names", "docstring_heads",
    "dialect_words", "constants_with_several_values", "files_above_500_lines",
)  # fmt: skip


def code_rows(text: str, nodes: list[ast.AST]) -> set[int]:
    """Numbers of the lines that hold code, 1 first."""
    lines = text.splitlines()
    rows = {number for number, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith("#")}
    docstrings: set[int] = set()
    for node in nodes:
        if (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ):
            docstrings.update(range(node.lineno, _end(node) + 1))
    for node in nodes:
        if not isinstance(node, ast.Constant | ast.JoinedStr) or node.lineno in docstrings:
            continue
        if not rows.issuperset(
            range(node.lineno, _end(node) + 1)
        ):  # a blank line or a # within a string, or beside one
            rows = {
                row
                for token in tokenize.generate_tokens(io.StringIO(text).readline)
                if token.type not in NOT_CODE
                for row in range(token.start[0], token.end[0] + 1)
            }
            break
    return rows - docstrings


def count() -> Count:
    """Read every file of the packages, benchmarks and tests."""
    found, constants = Count(), defaultdict(lambda: defaultdict(set))
    for top in (*PACKAGES, "benchmarks", "tests"):
        for path in sorted((ROOT / top).rglob("*.py")):
            text = path.read_text(encoding="utf-8")
            nodes = list(_walk(ast.parse(text)))
            rows = code_rows(text, nodes)
            found.code_lines[top] += len(rows)
            if top not in PACKAGES:
                continue
            lines, where = text.splitlines(), path.relative_to(ROOT).as_posix()
            found.characters += sum(len(lines[row - 1].rstrip()) for row in rows)
            if text.count("\n") > MAX_FILE_LINES:
                found.places["files_above_500_lines"].append(where)
            for number, line in enumerate(lines, 1):
                found.places["dialect_words"] += [f"{where}:{number} {word}" for word in DIALECT.findall(line)]
            for name, value in _constants(nodes[0]):
                constants[top][name].add(value)
            for node in nodes:
                _count_node(found, node, where)
    several = [f"{top}: {name}" for top, of in constants.items() for name, all_of in of.items() if len(all_of) > 1]
    found.places["constants_with_several_values"] = several
    return found


def _count_node(found: Count, node: ast.AST, where: str) -> None:
    """Count a function, class or module by its name, arguments and docstring."""
    if isinstance(node, Function):
        place = f"{where}:{node.lineno} {node.name}"
        arguments = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
        if sum(one.arg not in ("self", "cls") for one in arguments) > MAX_ARGUMENTS:
            kind = "kernels" if "/kernels/" in where else "functions"
            found.places[f"{kind}_above_8_arguments"].append(place)
        if not node.name.startswith("__"):
            found.functions += 1
            if is_participle(node.name):
                found.places["participle_names"].append(place)
    if isinstance(node, Function | ast.ClassDef | ast.Module) and (text := ast.get_docstring(node)):
        found.docstrings += 1
        if re.split(r"\W", text, maxsplit=1)[0] in CLAUSES:
            found.places["docstring_heads"].append(f"{where}:{getattr(node, 'lineno', 1)} {text.splitlines()[0]}")


def is_participle(name: str) -> bool:
    """Return whether the first word of a function's name is a bare participle or adverb."""
    first = name.strip("_").split("_")[0]
    return bool(ENDS_IN_ED.fullmatch(first) or IRREGULAR.fullmatch(first))


def _constants(module: ast.AST) -> Iterator[tuple[str, float]]:
    """Names in capitals that a module sets to a number."""
    for node in module.body if isinstance(module, ast.Module) else ():
        value = node.value if isinstance(node, ast.Assign) else None
        if (
            isinstance(node, ast.Assign)
            and isinstance(value, ast.Constant)
            and isinstance(value.value, int | float)
        ):
            names = [target.id for target in node.targets if isinstance(target, ast.Name)]
            yield from ((name, value.value) for name in names if name.isupper())


def _walk(tree: ast.Module) -> Iterator[ast.AST]:
    """Nodes of a tree without what lies inside expressions of one line: nothing there counts."""
    waiting: list[ast.AST] = [tree]
    while waiting:
        node = waiting.pop()
        yield node
        for child in ast.iter_child_nodes(node):
            if not isinstance(child, ast.expr) or child.end_lineno != child.lineno:
                waiting.append(child)


def _end(node: ast.stmt | ast.expr) -> int:
    return node.end_lineno or node.lineno


def budget() -> dict[str, float]:
    """Budget of every row."""
    tables = tomllib.loads(FILE.read_text(encoding="utf-8"))
    return {name: most for table in tables.values() for name, most in table.items()}


def rows_above(rows: dict[str, float], most: dict[str, float]) -> list[str]:
    """One sentence for every row above its budget, with the excess and the cure."""
    return [
        f"{name} is {rows[name]:g}, {rows[name] - most[name]:g} above its budget: bring it down"
        f"{f' (python -m tests.budget {name} lists the places)' if name in PLACES else ''}, "
        "or raise it in tests/budget.toml with an ADR that says what is bought"
        for name in rows
        if rows[name] > most[name]
    ]


def lower(rows: dict[str, float]) -> None:
    """Write today's count of every row that is below its budget."""
    text, most = FILE.read_text(encoding="utf-8"), budget()
    for name, value in rows.items():
        if value < most[name] and name != LIMIT:
            text = re.sub(rf"^{name} = .*$", f"{name} = {value:g}", text, flags=re.MULTILINE)
    FILE.write_text(text, encoding="utf-8")


def main(words: list[str]) -> None:
    """Print the table or the places of a row, or lower the budget."""
    found = count()
    if words == ["--lower"]:
        lower(found.rows)
    elif words:
        print(*found.places[words[0]], sep="\n")
        return
    most = budget()
    for name, value in found.rows.items():
        print(f"{'! ' if value > most[name] else '  '}{name:34}{value:>9g}{most[name]:>9g}{found.share(name)}")


if __name__ == "__main__":
    main(sys.argv[1:])
