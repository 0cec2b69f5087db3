"""Where the compiled code of a kernel is kept, so that an edit is never missed and never costs more than it must.

Numba's own key is the content of the DEFINING file alone: after an edit in a callee's file it silently returns
numbers of the old code.  So each file of kernels has a folder of its own, whose name is the digest of all that its
machine code is made of: the file, every file of kernels that it imports, directly or through others, what those
take constants from, the options (`ground.jit`) and numba's version.  An edit gives new folders to the files that
see it, and to no others: who changes a kernel of the PIV compiles no ray anew.

Imports are read from the text, at any depth of indentation; one import is not written there: bodies register what
rays do with them by type (`tracer.kernels.world.KINDS`), so who imports `world` is taken to import every body.
Each text is read once a process, as Python itself does.  Files that are not kernels count by their own text and
not by what they import: kernels take constants and named tuples from them, nothing that computes.
"""

import hashlib
import os
import re
from functools import cache
from pathlib import Path

import numba

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("ground", "tracer", "correction", "stages", "daq", "sim")
KERNEL_FOLDERS = ("kernels", "tracer/bodies", "sim/renderer")
REGISTERED = {"tracer/kernels/world.py": "tracer/bodies/*.py"}  # what is reached by type instead of by import
ALWAYS = ("ground/jit.py",)
_FROM = re.compile(r"^[ \t]*from[ \t]+([\w.]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)", re.MULTILINE)
_IMPORT = re.compile(r"^[ \t]*import[ \t]+([\w.]+)", re.MULTILINE)


def cache_folder(source: Path, root: Path = ROOT) -> Path:
    """Folder for the compiled code of a file: below RTPIV_CACHE, else the user's cache folder.

    Parameters
    ----------
    source : path
        File that defines kernels.
    root : path
        Folder of the packages.
    """
    base = os.environ.get("RTPIV_CACHE") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "rtpiv" / digest_of(source.resolve(), root)


@cache
def digest_of(source: Path, root: Path = ROOT) -> str:
    """Digest (16 hex digits) of everything that the compiled code of a file is made of."""
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted({*dependencies(source, root), *(root / name for name in ALWAYS)}):
        digest.update(path.name.encode() + b"\0" + _content(path))
    return digest.hexdigest()[:16]


def dependencies(source: Path, root: Path = ROOT) -> set[Path]:
    """Files whose text a kernel file depends on, itself included."""
    found: set[Path] = set()
    left = [source]
    while left:
        path = left.pop()
        if path in found:
            continue
        found.add(path)
        if path == source or _has_kernels(path, root):
            left.extend(_imported(path, root))
    return found


def _has_kernels(path: Path, root: Path) -> bool:
    folder = path.parent
    return folder.name == KERNEL_FOLDERS[0] or any(folder == root / name for name in KERNEL_FOLDERS[1:])


@cache
def _content(path: Path) -> bytes:
    return path.read_bytes()


@cache
def _imported(path: Path, root: Path) -> tuple[Path, ...]:
    """Our files that a file imports, and those that register themselves with it."""
    text = _content(path).decode(errors="replace")
    found: list[Path] = []
    for module, names in _FROM.findall(text):
        found += _files_of(module, root)
        for name in re.findall(r"\w+", names):  # may be modules themselves
            found += _files_of(f"{module}.{name}", root)
    for module in _IMPORT.findall(text):
        found += _files_of(module, root)
    for name, pattern in REGISTERED.items():
        if path == root / name:
            found += sorted(root.glob(pattern))
    return tuple(found)


def _files_of(module: str, root: Path) -> list[Path]:
    parts = module.split(".")
    if parts[0] not in PACKAGES:
        return []
    place = root.joinpath(*parts)
    return [path for path in (place.with_suffix(".py"), place / "__init__.py") if path.is_file()]
