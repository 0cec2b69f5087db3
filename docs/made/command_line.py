"""The page of the command line, from the parser that reads it."""

import argparse
import re

from rtpiv.options import parser, parser_of
from rtpiv.options.command import commands

EVERYWHERE = ("help", "threads", "trust")  # options of every verb: said once


def text() -> str:
    """Write Markdown: the options that every verb has, then the verbs in the order of `rtpiv --help`."""
    words = parser()
    shared = [action for action in words._actions if action.dest in (*EVERYWHERE, "version")]
    parts = ["## With every verb", *map(_option, shared)]
    for name in commands():
        verb = parser_of(name)
        parts += [f"## {name}", escaped(_whole(verb.description or "")), *_verb(verb)]
    return "\n\n".join(parts) + "\n"


def _verb(verb: argparse.ArgumentParser) -> list[str]:
    """How it is called, then what it takes; what belongs together under a line of its own."""
    taken = [action for action in verb._actions if action.dest not in EVERYWHERE]
    words = [_follows(action) for action in taken if not action.option_strings]
    required = [action for action in taken if action.option_strings and action.required]
    must = [f"{action.option_strings[-1]} {_follows(action)}" for action in required]
    parts = ["`" + " ".join((verb.prog, *words, *must)) + " [options]`"]
    for group in verb._action_groups:
        actions = [action for action in group._group_actions if action.dest not in EVERYWHERE]
        if actions and group.title not in ("positional arguments", "options"):
            parts.append(f"**{escaped(_whole(group.title or ''))}**")
        parts += map(_option, actions)
    return parts


def _follows(action: argparse.Action) -> str:
    """What is said of a word, or after the name of an option."""
    return "" if action.nargs == 0 else argparse.HelpFormatter("")._format_args(action, action.dest.upper())


def _option(action: argparse.Action) -> str:
    """One option as a definition: its names with what follows them, and what it means."""
    names, follows = action.option_strings or [_follows(action)], _follows(action) if action.option_strings else ""
    shown = ", ".join(f"`{name}`" for name in names) + (f" `{follows}`" if follows else "")
    meaning = _whole((action.help or "").replace("%%", "%"))
    return f"{shown}\n: {escaped(meaning)}{' Required.' if action.required and action.option_strings else ''}"


def _whole(text: str) -> str:
    """A sentence with its first letter and its stop."""
    text = " ".join(text.split())
    return text[:1].upper() + text[1:] + ("" if text.endswith((".", "?", ":")) else ".")


def escaped(text: str) -> str:
    """Text in which nothing is a mark of Markdown."""
    return re.sub(r"([\\`*_{}\[\]<>#|~$^])", r"\\\1", text)
