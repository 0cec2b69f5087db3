"""Hatchling's hook: a wheel takes the machine code that `make dist` has made, and says for whom it is.

Without any (an sdist that pip installs, a wheel built by hand) it is plain Python, and compiles at its first use.
"""

import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

MADE = Path("build/machine_code")
INSTALLED = "ground/jit/machine_code"


class MachineCodeHook(BuildHookInterface):  # type: ignore[type-arg]
    """Puts the folders of kinds of processors beside the code that looks for them."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Name the files and the tag, if there is machine code."""
        kinds = sorted((Path(self.root) / MADE).glob("numba-*/x86-64-*/rtpiv"))
        if not kinds or self.target_name != "wheel":
            return
        for kind in kinds:
            numba, name, _ = kind.parts[-3:]
            build_data["force_include"][str(kind)] = f"{INSTALLED}/{numba}/{name}"
        build_data["pure_python"] = False
        python = f"cp{sys.version_info.major}{sys.version_info.minor}"
        # What it calls of the C library has no version: any Linux will do that numba itself takes.
        build_data["tag"] = f"{python}-{python}-manylinux2014_x86_64"
