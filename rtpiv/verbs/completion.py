"""`rtpiv setup completion`: print the completion script of a shell.

The script is made from the parsers.  A word that begins with a dash is completed to options of the command, the
first words to verbs and their parts, the values of a choice to its choices; everything else to files.
"""

import argparse
from typing import Literal

from rtpiv.options.command import PARTS, VARIANTS, VERBS, commands, help_of, parser_of

BASH = """\
_rtpiv() {{
  local now="${{COMP_WORDS[COMP_CWORD]}}" before="${{COMP_WORDS[COMP_CWORD-1]}}" words=""
  if [[ $COMP_CWORD -eq 1 ]]; then
    COMPREPLY=($(compgen -W "{verbs} --help --version --threads" -- "$now"))
    return
  fi
  case "${{COMP_WORDS[1]}} ${{COMP_WORDS[2]}}" in
{cases}
  esac
  COMPREPLY=($(compgen -W "$words" -- "$now"))
  if [[ -z "$words" ]]; then COMPREPLY=($(compgen -f -- "$now")); fi
}}
complete -o filenames -F _rtpiv rtpiv
"""
ZSH = "autoload -U +X bashcompinit && bashcompinit\n"


def completion(shell: Literal["bash", "zsh", "fish"], /) -> str:
    """Print the completion script of a shell; ``source <(rtpiv setup completion bash)`` enables it.

    Parameters
    ----------
    shell : {"bash", "zsh", "fish"}
        The shell.

    Returns
    -------
    str
        The script.
    """
    script = completion_script(shell)
    print(script, end="")
    return script


def completion_script(shell: str) -> str:
    """Return the script for "bash", "zsh" or "fish"."""
    if shell == "fish":
        return _fish()
    cases = [_bash_case(command) for command in sorted(commands(), key=lambda each: -each.count(" "))]
    cases += [f'    "{verb} "*) words="{" ".join(parts)}" ;;' for verb, parts in PARTS.items()]
    script = BASH.format(verbs=" ".join(VERBS), cases="\n".join(cases))
    return ZSH + script if shell == "zsh" else script


def _options(command: str) -> dict[str, tuple[str, str]]:
    """Return help and choices of each long option of a command; without a name those of its words."""
    found = {each: (help_of(name), "") for each, name in VARIANTS.get(command, {}).items()}
    for action in parser_of(command)._actions:
        choices = " ".join(map(str, action.choices or ()))
        names = [name for name in action.option_strings if name.startswith("--")]
        if action.help != argparse.SUPPRESS:
            found |= {name: (action.help or "", choices) for name in names or [""] if names or choices}
    return found


def _bash_case(command: str) -> str:
    """Return the completion of one command."""
    options = _options(command)
    chosen = [f'{name}) words="{choices}" ;;' for name, (_, choices) in options.items() if name and choices]
    of_options = [f'      case "$before" in {each} esac' for each in [" ".join(chosen)] if each]
    every, plain = " ".join(filter(None, options)), options.get("", ("", ""))[1]
    pattern = f'"{command}"' if " " in command else f'"{command} "*'
    return "\n".join(
        [
            f"    {pattern})",
            *of_options,
            f'      if [[ -z "$words" && "$now" == -* ]]; then words="{every}"',
            f'      elif [[ -z "$words" ]]; then words="{plain}"; fi ;;',
        ]
    )


def _fish() -> str:
    """Return the script for fish."""
    lines = [f"complete -c rtpiv -n __fish_use_subcommand -l {name}" for name in ("help", "version")]
    for verb in VERBS:
        lines.append(f"complete -c rtpiv -f -n __fish_use_subcommand -a {verb} -d {_quote(help_of(verb))}")
        for part in PARTS.get(verb, ()):
            seen = f"'__fish_seen_subcommand_from {verb}'"
            lines.append(f"complete -c rtpiv -f -n {seen} -a {part} -d {_quote(help_of(part))}")
    for command in commands():
        seen = _quote("; and ".join(f"__fish_seen_subcommand_from {word}" for word in command.split()))
        for name, (text, choices) in _options(command).items():
            values = (
                f" -x -a {_quote(choices)}" if name and choices else f" -a {_quote(choices)}" if choices else ""
            )
            option = f" -l {name[2:]}" if name else ""
            lines.append(f"complete -c rtpiv -n {seen}{option}{values} -d {_quote(text)}")
    return "\n".join(lines) + "\n"


def _quote(text: str) -> str:
    return "'" + text.replace("\\", "\\\\").replace("'", "\\'") + "'"
