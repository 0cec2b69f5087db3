"""`rtpiv completion`: completion of verbs and options in a shell."""

from typing import Literal

from rtpiv.command_line.completion_script import completion_script
from rtpiv.options import parser


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
