"""Programs that a file names, as "package.module:callable": imported and called only if the person trusts them.

A bench file may name drivers, cameras and objects of other projects, and with them any program of this computer.
So a file of another person is asked about before such a name is imported, once for each name: trusted are the
names that rtpiv ships, those in the environment variable RTPIV_TRUST (``--trust`` of the command line puts them
there), and those in a file of the person's own, one name a line.
"""

import os
from collections.abc import Iterable, Mapping
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ground.errors import UntrustedProgram

VARIABLE = "RTPIV_TRUST"  # names with commas between
SHIPPED = frozenset({  # what rtpiv itself names, and the core that a bench file need not name
    "sim.bench:SimulatedBench", "sim.camera.core:SimCore", "sim.camera.in_process:InProcessCamera",
    "sim.emulators.micromanager:SimulatedCore",
    "sim.emulators.positioners:SimulatedPositioner", "sim.timing:SimulatedSwitch", "pymmcore:CMMCore",
})  # fmt: skip


class UnknownName(LookupError):  # noqa: N818 - says what it is
    """A name that rtpiv does not ship, and that names no program of another project either."""


def trust_file() -> Path:
    """File of the names that this person trusts; it need not exist."""
    base = os.environ.get("XDG_CONFIG_HOME")
    return (Path(base) if base else Path.home() / ".config") / "rtpiv" / "trusted_programs.txt"


def is_trusted(dotted: str) -> bool:
    """Return whether a program may be imported and called."""
    if dotted in SHIPPED or dotted in os.environ.get(VARIABLE, "").split(","):
        return True
    try:
        return dotted in trust_file().read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):  # no such file, no home, no text: nothing is trusted
        return False


def is_installed(dotted: str) -> bool:
    """Return whether the package of a program is there; nothing is imported."""
    return find_spec(dotted.partition(":")[0].partition(".")[0]) is not None


def require_trust(names: Iterable[str]) -> None:
    """Refuse programs that the person does not trust.

    Raises
    ------
    UntrustedProgram
        All of them at once.
    """
    if strange := [name for name in dict.fromkeys(names) if not is_trusted(name)]:
        raise UntrustedProgram(strange, trust_file())


def trust(names: Iterable[str]) -> None:
    """Keep names in the person's file.

    Raises
    ------
    OSError
        It cannot be written.
    """
    path = trust_file()
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8") as file:
        file.writelines(f"{name}\n" for name in names)


def program_of(name: str, shipped: Mapping[str, str]) -> Any:  # noqa: ANN401 - whatever the name stands for
    """Import what a name in a file stands for: what rtpiv ships, or "package.module:callable" of another project.

    Parameters
    ----------
    name : str
        As the file has it.
    shipped : mapping
        What rtpiv has under short names; imported only now.

    Returns
    -------
    object
        What stands there.

    Raises
    ------
    UnknownName
        It is neither.
    UntrustedProgram
        It is of another project, and not trusted; nothing of it has run.
    ImportError, AttributeError
        It is not there.
    """
    if name in shipped:
        module, _, attribute = shipped[name].partition(":")
        return getattr(import_module(module), attribute)
    if ":" not in name:
        raise UnknownName(name)
    return import_program(name)


def import_program(dotted: str) -> Any:  # noqa: ANN401 - whatever the name stands for
    """Import what a file names.

    Raises
    ------
    UntrustedProgram
        It is not trusted; nothing of it has run.
    ImportError, AttributeError
        It is not there.
    """
    require_trust([dotted])
    module, _, name = dotted.partition(":")
    return getattr(import_module(module), name)
