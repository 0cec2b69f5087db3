"""The whole command line: words and options of each verb as `rtpiv.options.signature` reads them."""

import argparse
from collections.abc import Collection
from importlib import import_module
from pathlib import Path
from typing import Any

from rtpiv.options import numbers
from rtpiv.options.signature import REQUIRED, Option, signature, summary, title

VERBS = (  # in the order in which they are listed
    "init", "examples", "schema", "warm", "completion", "benchmark", "demo",
    "compare", "trace", "target", "calibrate", "mask", "correct", "evaluate", "focus", "sheet", "join", "mean",
    "timeseries", "campaign", "report", "export",
    "acquire", "resume", "align", "check", "stage", "laser", "camera", "live", "devices", "probe", "doctor",
    "emulate",
)  # fmt: skip
WORDS = {  # options that are not called what their parameter is
    "out": ("-o", "--out"),
    "ask": ("--yes",),
    "as_float": ("--float",),
    "scenes": ("--scene",),
    "sigma_limit_px": ("--sigma-limit",),
    "sigma_w_m_s": ("--sigma-w",),
    "first_window_px": ("--first-window",),
    "final_window_px": ("--final-window",),
    "finest_window_px": ("--finest-window",),
    "slurm_options": ("--slurm-set",),
}
UNITS = ("mm", "um", "px", "us", "s", "hz", "nm", "deg")
TRUST = "programs named by the bench file that may be called, as package.module:name, with commas between"
CORES = "cores to use (default: all)"


class _Version(argparse.Action):
    """Looked up only when asked for: the library that knows it is slow to import."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        print(f"rtpiv {version('rtpiv')}")
        parser.exit()


def parser(said: Collection[str] | None = None) -> argparse.ArgumentParser:
    """Return the parser of the command line.

    Parameters
    ----------
    said : collection of str, optional
        Words that are to be read: only verbs among them get their options, as others cannot be asked for.

    Returns
    -------
    ArgumentParser
        With one subparser a verb.
    """
    words = argparse.ArgumentParser(
        prog="rtpiv", description="Particle image velocimetry through glass: acquire, trace, correct, prove."
    )
    words.add_argument("--version", action=_Version, nargs=0, default=argparse.SUPPRESS, help="say which and end")
    words.add_argument("--threads", type=numbers.count, metavar="N", help=CORES)
    words.add_argument("--trust", metavar="NAMES", help=TRUST)
    verbs = words.add_subparsers(dest="verb", metavar="VERB")
    for name in VERBS:
        verb = verbs.add_parser(name, help=summary(name).replace("%", "%%"))
        if said is None or name in said:
            _add_options(verb, name)
        verb.add_argument("--threads", type=numbers.count, metavar="N", default=argparse.SUPPRESS, help=CORES)
        verb.add_argument("--trust", metavar="NAMES", default=argparse.SUPPRESS, help=TRUST)
        verb.set_defaults(refuse=verb.error)  # which shows the verb's own usage
    return words


def call_of(verb: str, options: dict[str, Any]) -> tuple[list[Any], dict[str, Any]]:
    """Arguments of a verb's function from its options, values put together.

    Parameters
    ----------
    verb : str
        The verb.
    options : dict
        What was read, by name.

    Returns
    -------
    list, dict
        Positional and named arguments.
    """
    words, named, values = list[Any](), dict[str, Any](), dict[str, dict[str, Any]]()
    for option in signature(verb):
        if option.is_word:
            words.append(options[option.name])
        elif option.of is None:
            named[option.name] = options[option.name]
        elif option.of.keywords:  # what is not given is left out
            if options[option.name] is not None:
                named[option.name] = options[option.name]
        else:
            values.setdefault(option.holder, {})[option.name] = options[option.name]
    for option in signature(verb):
        if option.of is not None and option.holder in values:
            said = values.pop(option.holder)
            if option.holder in named and all(value is None for value in said.values()):
                continue  # a flag, and nothing that it might be else
            make = getattr(import_module(option.of.module), option.of.name)
            named[option.holder] = make(**said)
    return words, named


def _add_options(parser: argparse.ArgumentParser, verb: str) -> None:
    """Add what a verb takes; the fields of a value stand together."""
    groups: dict[str, argparse._ArgumentGroup] = {}
    for option in signature(verb):
        if option.is_word:
            _add_word(parser, option)
        elif option.of is not None:
            if option.holder not in groups:
                groups[option.holder] = parser.add_argument_group(title(option.of))
            _add_option(groups[option.holder], option)
        else:
            _add_option(parser, option)


def _add_word(parser: argparse.ArgumentParser, option: Option) -> None:
    """A word without a name; with a default it may be left out."""
    kind, there = option.kind, option.default is not REQUIRED
    many: Any = ("*" if there else "+") if kind.many else ("?" if there else None)
    more: dict[str, Any] = {"default": option.default} if there else {}
    if not kind.choices:
        more["metavar"] = option.name.upper()
    parser.add_argument(
        option.name, type=_reader(kind.read), nargs=many, choices=kind.choices, help=_help(option), **more
    )


def _add_option(parser: argparse._ActionsContainer, option: Option) -> None:
    """An option with a name; a flag turns over what holds without it."""
    kind = option.kind
    off = "no-" if kind.read == "bool" and option.default else ""
    names = WORDS.get(option.name, (f"--{off}{option.name.replace('_', '-')}",))
    if kind.read == "bool":
        action = "store_false" if option.default else "store_true"
        parser.add_argument(*names, dest=option.name, action=action, default=option.default, help=_help(option))
        return
    unit = option.name.partition("_per_")[0].rpartition("_")[2]  # mm_per_px is a number of mm
    metavar: Any = unit.upper() if unit in UNITS else names[-1].removeprefix("--").rpartition("-")[2].upper()
    parser.add_argument(
        *names, dest=option.name, type=_reader(kind.read), nargs=kind.many, choices=kind.choices,
        metavar=None if kind.choices else metavar, required=option.default is REQUIRED,
        default=None if option.default is REQUIRED else option.default, help=_help(option),
    )  # fmt: skip


def _reader(name: str) -> Any:  # noqa: ANN401 - argparse takes any callable
    return {"str": str, "Path": Path}.get(name) or getattr(numbers, name)


def _help(option: Option) -> str:
    """Its description, with the default if that is not said."""
    text, default = option.help.replace("%", "%%").rstrip("."), option.default
    if option.kind.read == "bool" and default:
        text = f"do not {text[:1].lower()}{text[1:]}"
    plain = default not in (None, REQUIRED, (), "") and option.kind.read != "bool"
    if plain and "default" not in text:
        shown = " ".join(map(str, default)) if isinstance(default, tuple) else str(default)
        text += f" (default: {shown})"
    return text
