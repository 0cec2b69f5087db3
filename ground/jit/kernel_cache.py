"""Cache of the compiled code of kernels: no edit is missed, and none costs more than it must.

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

import atexit
import hashlib
import os
import re
import shutil
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path

import ground.jit.compile_news as compile_news

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("ground", "piv", "tracer", "correction", "stages", "daq", "sim", "rtpiv")
REGISTERED = {"tracer/kernels/world.py": "tracer/bodies/*.py"}  # what is reached by type instead of by import
COMPILING = "ground/jit"  # compiles kernels and holds none
ALWAYS = ("ground/jit/__init__.py",)
_FROM = re.compile(r"^[ \t]*from[ \t]+([\w.]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)", re.MULTILINE)
_COMPILES = re.compile(r"^[ \t]*(from|import)[ \t]+ground\.jit\b", re.MULTILINE)
_IMPORT = re.compile(r"^[ \t]*import[ \t]+([\w.]+)", re.MULTILINE)


def cache_folder(source: Path, root: Path = ROOT) -> Path | None:
    """Folder for the compiled code of a file: below RTPIV_CACHE, else the user's cache folder; None without one.

    Parameters
    ----------
    source : path
        File that defines kernels.
    root : path
        Folder of the packages.
    """
    base = _base(os.environ.get("RTPIV_CACHE") or os.environ.get("XDG_CACHE_HOME"))
    return None if base is None else base / "rtpiv" / digest_of(source.resolve(), root)


def _temporary(full: Path | None) -> Path | None:
    """A folder for this process and its children, with links to what one that cannot be written holds."""
    try:
        place = Path(tempfile.mkdtemp(prefix="rtpiv-kernels-"))
    except OSError:
        return None
    if full is None:
        return place
    with suppress(OSError):
        for path in sorted((full / "rtpiv").rglob("*")):
            beside = place / path.relative_to(full)
            if path.is_dir():
                beside.mkdir(parents=True, exist_ok=True)
            else:
                beside.symlink_to(path)
    return place


@cache
def _base(wanted: str | None) -> Path | None:
    """Folder of all compiled code; what a person should know about it is said at once.

    One that cannot be written is replaced by a temporary one, which the processes that this one starts share and
    which goes with it; if it was filled before, as by `rtpiv setup warm` in an image, its contents are used.
    Numba would look for others by itself, and end the program if it finds none.
    """
    base: Path | None = None
    try:
        base = Path(wanted) if wanted else Path.home() / ".cache"
        (base / "rtpiv").mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=base / "rtpiv"):
            return base
    except (OSError, RuntimeError) as error:  # no folder of this user, too
        name = getattr(error, "filename", None) or wanted or "the user's cache folder"
        why = f"{name} cannot be written ({(getattr(error, 'strerror', None) or str(error)).lower()})"
    place = _temporary(base)
    if compile_news.complain is not None and (place is None or not any(place.rglob("*.nbi"))):
        cure = "set RTPIV_CACHE to a folder of yours"
        compile_news.complain(f"{why}, so kernels are compiled anew each time; {cure}")
    if place is None:
        return None
    owner = os.getpid()

    def remove() -> None:
        if os.getpid() == owner:  # not in a forked child
            shutil.rmtree(place, ignore_errors=True)

    atexit.register(remove)
    os.environ["RTPIV_CACHE"] = str(place)
    return place


@cache
def digest_of(source: Path, root: Path = ROOT) -> str:
    """Digest (16 hex digits) of everything that the compiled code of a file is made of."""
    import numba  # imported by now, because a kernel is compiled

    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted({*dependencies(source, root), *(root / name for name in ALWAYS)}):
        digest.update(_name_of(path, root).encode() + b"\0" + _content(path))
    return digest.hexdigest()[:16]


def _name_of(path: Path, root: Path) -> str:
    """Its place below the packages: machine code names the modules that it was made from, so a move counts too."""
    return path.relative_to(root).as_posix() if path.is_relative_to(root) else path.name


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
            left.extend(_imports_of(path, root))
    return found


def _has_kernels(path: Path, root: Path) -> bool:
    """Return whether a file holds kernels, or registers those that it imports: the file itself says so."""
    if path.parent == root / COMPILING:
        return False
    if path.parent.name == "kernels" or _COMPILES.search(_content(path).decode(errors="replace")):
        return True
    return any(path.match(pattern) and path.is_relative_to(root) for pattern in REGISTERED.values())


@cache
def _content(path: Path) -> bytes:
    return path.read_bytes()


@cache
def _imports_of(path: Path, root: Path) -> tuple[Path, ...]:
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


@cache  # many files import the same
def _files_of(module: str, root: Path) -> list[Path]:
    top, *below = module.split(".")
    if top not in PACKAGES:
        return []
    place = os.path.join(root, top, *below)  # noqa: PTH118 - thrice as quick, and each command waits for hundreds
    return [Path(name) for name in (f"{place}.py", f"{place}/__init__.py") if os.path.isfile(name)]  # noqa: PTH113
