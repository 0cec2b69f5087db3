"""Parsers of the command line: verbs in groups, with the options that `rtpiv.options.signature` reads."""

import argparse
from collections.abc import Collection, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from rtpiv.options import numbers
from rtpiv.options.signature import REQUIRED, Option, signature, summary, title

GROUPS = {  # verbs as `rtpiv --help` lists them
    "measure": (
        "trace",
        "compare",
        "calibrate",
        "correct",
        "evaluate",
        "mean",
        "campaign",
        "report",
        "export",
        "sheet",
        "focus",
    ),
    "bench": ("acquire", "align", "bench", "laser"),
    "set-up": ("init", "setup", "check", "doctor", "demo"),
}
VERBS = tuple(verb for verbs in GROUPS.values() for verb in verbs)
PARTS = {  # verbs that need a second word, and what each is for
    "bench": ("stage", "camera", "live", "emulate"),
    "setup": ("examples", "schema", "target", "mask", "completion", "warm"),
}
PARTS_HELP = {
    "bench": "stages and camera by hand, live images, the simulated bench for other programs",
    "setup": "example files, schemas, printed targets, masks, shell completion, compilation",
}
VARIANTS = {  # options that make another function of a verb, with other options
    "acquire": {"--resume": "resume"},
    "calibrate": {"--join": "calibrate_cameras"},
    "mean": {"--join": "join", "--at": "timeseries", "--line": "timeseries"},
    "doctor": {"--probe": "probe"},
    "report": {"--view": "view"},
}
RENAMED = {  # until the next release
    "resume": "acquire --resume",
    "join": "mean --join",
    "timeseries": "mean",
    "devices": "doctor",
    "probe": "doctor --probe",
} | {part: f"{verb} {part}" for verb, parts in PARTS.items() for part in parts}
REMOVED = {"benchmark": "use python -m benchmarks.race --scenes SCENE in a checkout of the sources"}
WORDS = {  # options with other names than their parameters
    "out": ("-o", "--out"),
    "ask": ("--yes",),
    "as_float": ("--float",),
    "scenes": ("--scene",),
    "sigma_limit_px": ("--sigma-limit",),
    "sigma_w_m_s": ("--sigma-w",),
    "first_window_px": ("--first-window",),
    "final_window_px": ("--final-window",),
    "finest_window_px": ("--finest-window",),
}
UNITS = ("mm", "um", "px", "us", "s", "hz", "nm", "deg")
TRUST = "programs named by the bench file that may be called, as package.module:name, with commas between"
CORES = "cores to use (default: all)"
WITH_VALUE = ("--threads", "--trust")


class _Version(argparse.Action):
    """Print the version, whose library is slow to import."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        print(f"rtpiv {version('rtpiv')}")
        parser.exit()


def current(words: Sequence[str]) -> tuple[list[str], str]:
    """Replace a renamed verb in the words of a command, and announce a removed one.

    Parameters
    ----------
    words : sequence of str
        Words of the command line.

    Returns
    -------
    list of str, str
        The words with today's names, none of a removed verb, and the sentence that says so; "" if nothing changed.
    """
    for at, word in enumerate(words):
        if not word.startswith("-") and (at == 0 or words[at - 1] not in WITH_VALUE):
            if word in REMOVED:
                return [], f"rtpiv {word} has been removed: {REMOVED[word]}"
            if word not in RENAMED:
                break
            notice = f"rtpiv {word} is now rtpiv {RENAMED[word]}; the old name goes with the next release"
            return [*words[:at], *RENAMED[word].split(), *words[at + 1 :]], notice
    return list(words), ""


def commands() -> dict[str, str]:
    """Return the function of every command: of verbs, their parts, and their variants."""
    found: dict[str, str] = {}
    for verb in VERBS:
        found |= {f"{verb} {part}": part for part in PARTS[verb]} if verb in PARTS else {verb: verb}
        found |= {f"{verb} {option}": name for option, name in VARIANTS.get(verb, {}).items()}
    return found


def parser(said: Collection[str] | None = None) -> argparse.ArgumentParser:
    """Return the parser of the command line.

    Parameters
    ----------
    said : collection of str, optional
        Words that are to be read: only verbs among them get their options, and those of the variant that the
        words ask for.  Without them every verb gets its own options.

    Returns
    -------
    ArgumentParser
        With one subparser a verb.
    """
    root = argparse.ArgumentParser(
        prog="rtpiv", description=_listing(), formatter_class=argparse.RawDescriptionHelpFormatter
    )
    root.add_argument("--version", action=_Version, nargs=0, default=argparse.SUPPRESS, help="print the version")
    _add_shared(root, None)
    verbs = root.add_subparsers(dest="verb", metavar="VERB", help="one of these")
    for verb in VERBS:
        if verb in PARTS:
            about = help_of(verb)
            parts = verbs.add_parser(verb, description=about).add_subparsers(
                dest="verb", metavar="PART", required=True
            )
            for part in PARTS[verb]:
                _fill(parts.add_parser(part, help=help_of(part).replace("%", "%%")), part, f"{verb} {part}", said)
        else:
            _fill(verbs.add_parser(verb), verb, verb, said)
    return root


def parser_of(command: str) -> argparse.ArgumentParser:
    """Return the parser of one command, such as "bench stage" or "mean --join"."""
    found = parser(words := command.split())
    for word in words:
        choices = next((each.choices for each in found._actions if each.dest == "verb"), None)
        found = choices[word] if isinstance(choices, dict) else found
    return found


def _listing() -> str:
    """Return the purpose of the program, and what each verb is for."""
    lines = ["Particle image velocimetry through glass: acquire, trace, correct, evaluate."]
    for group, verbs in GROUPS.items():
        lines += ["", f"{group}:", *(f"  {verb:<10} {help_of(verb)}" for verb in verbs)]
    return "\n".join(lines)


def help_of(verb: str) -> str:
    """Return the purpose of a verb, a part or the function of a variant."""
    return PARTS_HELP.get(verb) or summary(verb)


def _fill(parser: argparse.ArgumentParser, verb: str, command: str, said: Collection[str] | None) -> None:
    """Give a parser the options of its function, or of the variant that is asked for."""
    variants = VARIANTS.get(verb, {})
    given = () if said is None else [word.partition("=")[0] for word in said]
    asked = next((option for option in variants if option in given), "")
    function = variants.get(asked, verb)
    if said is None or verb in said:
        parser.description = help_of(function)
        _add_options(parser, function)
        if asked and asked not in parser._option_string_actions:
            parser.prog += f" {asked}"
            parser.add_argument(asked, action="store_true", dest="variant", help=argparse.SUPPRESS)
        elif not asked and variants:
            also = {name: option for option, name in reversed(variants.items())}  # the first option of each
            parser.epilog = "Also: " + "; ".join(
                f"{option}, {help_of(name)} (rtpiv {verb} --help {option})" for name, option in also.items()
            )
    _add_shared(parser, argparse.SUPPRESS)
    parser.set_defaults(verb=function, command=f"{command} {asked}".strip(), refuse=parser.error)


def _add_shared(parser: argparse.ArgumentParser, default: str | None) -> None:
    """Add the options of every verb, which may stand before it and behind."""
    parser.add_argument("--threads", type=numbers.count, metavar="N", default=default, help=CORES)
    parser.add_argument("--trust", metavar="NAMES", default=default, help=TRUST)


def call_of(verb: str, options: dict[str, Any]) -> tuple[list[Any], dict[str, Any]]:
    """Return the arguments of a verb's function, with options of one value put together.

    Parameters
    ----------
    verb : str
        The verb.
    options : dict
        Parsed options, by name.

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
    """Add the options of a verb; the fields of a value form a group."""
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
    """Add a positional argument; one with a default is optional."""
    kind, there = option.kind, option.default is not REQUIRED
    many: Any = ("*" if there else "+") if kind.many else ("?" if there else None)
    more: dict[str, Any] = {"default": option.default} if there else {}
    if not kind.choices:
        more["metavar"] = option.name.upper()
    parser.add_argument(
        option.name, type=_reader(kind.read), nargs=many, choices=kind.choices, help=_help(option), **more
    )


def _add_option(parser: argparse._ActionsContainer, option: Option) -> None:
    """Add an option; a flag inverts its default."""
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
        *names,
        dest=option.name,
        type=_reader(kind.read),
        nargs=kind.many,
        choices=kind.choices,
        metavar=None if kind.choices else metavar,
        required=option.default is REQUIRED,
        default=None if option.default is REQUIRED else option.default,
        help=_help(option),
    )


def _reader(name: str) -> Any:  # noqa: ANN401 - argparse takes any callable
    return {"str": str, "Path": Path}.get(name) or getattr(numbers, name)


def _help(option: Option) -> str:
    """Return the description, with the default if it does not mention one."""
    text, default = option.help.replace("%", "%%").rstrip("."), option.default
    if option.kind.read == "bool" and default:
        text = f"do not {text[:1].lower()}{text[1:]}"
    plain = default not in (None, REQUIRED, (), "") and option.kind.read != "bool"
    if plain and "default" not in text:
        shown = " ".join(map(str, default)) if isinstance(default, tuple) else str(default)
        text += f" (default: {shown})"
    return text
