"""`rtpiv completion`: completion of verbs and options in a shell.

The script is made from the parser itself.  A word that begins with a dash is completed to options of the verb, the
first other word to a verb, the words of a choice to its choices; everything else to files.
"""

import argparse
from collections.abc import Iterator
from typing import Literal

from rtpiv.options import parser


def completion_script(parser: argparse.ArgumentParser, shell: str) -> str:
    """Return the script for a shell.

    Parameters
    ----------
    parser : ArgumentParser
        Of the command, with verbs as its only subparsers.
    shell : {"bash", "zsh", "fish"}
        Which one.
    """
    verbs = _verbs(parser)
    return _fish(verbs) if shell == "fish" else _bash(verbs, shell == "zsh")


def _verbs(parser: argparse.ArgumentParser) -> dict[str, tuple[str, argparse.ArgumentParser]]:
    """Each verb with its help and parser."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            helps = {choice.dest: choice.help or "" for choice in action._choices_actions}
            return {name: (helps.get(name, ""), verb) for name, verb in action.choices.items()}
    return {}


def _options(verb: argparse.ArgumentParser) -> Iterator[tuple[str, str, list[str]]]:
    """Long name, help and choices of each option."""
    for action in verb._actions:
        choices = [str(choice) for choice in action.choices or ()]
        yield from ((name, action.help or "", choices) for name in action.option_strings if name.startswith("--"))


def _words(verb: argparse.ArgumentParser) -> list[str]:
    """Choices of words that are no options."""
    return [str(c) for action in verb._actions if not action.option_strings for c in action.choices or ()]


def _bash(verbs: dict[str, tuple[str, argparse.ArgumentParser]], zsh: bool) -> str:
    cases = []
    for name, (_, verb) in verbs.items():
        options = list(_options(verb))
        lines = [f"    {name})"]
        if chosen := [(option, choices) for option, _, choices in options if choices]:
            lines.append('      case "$before" in')
            lines += [f'        {option}) words="{" ".join(choices)}" ;;' for option, choices in chosen]
            lines.append("      esac")
        every = " ".join(option for option, _, _ in options)
        lines.append(f'      if [[ -z "$words" && "$now" == -* ]]; then words="{every}"')
        lines.append(f'      elif [[ -z "$words" ]]; then words="{" ".join(_words(verb))}"; fi ;;')
        cases.append("\n".join(lines))
    begin = "autoload -U +X bashcompinit && bashcompinit\n" if zsh else ""
    body = "\n".join(cases)
    return f"""\
{begin}_rtpiv() {{
  local now="${{COMP_WORDS[COMP_CWORD]}}" before="${{COMP_WORDS[COMP_CWORD-1]}}" words=""
  if [[ $COMP_CWORD -eq 1 ]]; then
    COMPREPLY=($(compgen -W "{" ".join(verbs)} --help --version --threads" -- "$now"))
    return
  fi
  case "${{COMP_WORDS[1]}}" in
{body}
  esac
  COMPREPLY=($(compgen -W "$words" -- "$now"))
  if [[ -z "$words" ]]; then COMPREPLY=($(compgen -f -- "$now")); fi
}}
complete -o filenames -F _rtpiv rtpiv
"""


def _fish(verbs: dict[str, tuple[str, argparse.ArgumentParser]]) -> str:
    lines = [
        "complete -c rtpiv -n __fish_use_subcommand -l help",
        "complete -c rtpiv -n __fish_use_subcommand -l version",
    ]
    for name, (help_text, verb) in verbs.items():
        lines.append(f"complete -c rtpiv -f -n __fish_use_subcommand -a {name} -d {_quoted(help_text)}")
        seen = f"'__fish_seen_subcommand_from {name}'"
        for option, about, choices in _options(verb):
            value = f" -x -a {_quoted(' '.join(choices))}" if choices else ""
            lines.append(f"complete -c rtpiv -n {seen} -l {option[2:]}{value} -d {_quoted(about)}")
        if words := _words(verb):
            lines.append(f"complete -c rtpiv -n {seen} -a {_quoted(' '.join(words))}")
    return "\n".join(lines) + "\n"


def _quoted(text: str) -> str:
    return "'" + text.replace("\\", "\\\\").replace("'", "\\'") + "'"


def completion(shell: Literal["bash", "zsh", "fish"], /) -> str:
    """Print the script that completes `rtpiv` in a shell; ``source <(rtpiv completion bash)`` switches it on.

    Parameters
    ----------
    shell : {"bash", "zsh", "fish"}
        Which one.

    Returns
    -------
    str
        The script.
    """
    script = completion_script(parser(), shell)
    print(script, end="")
    return script
