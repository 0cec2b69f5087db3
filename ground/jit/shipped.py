"""Machine code that comes with a wheel, so that the first command on a computer need not compile.

    ground/jit/machine_code/numba-0.68.1/x86-64-v3/<digest of a kernel's file>/    `make dist` makes it

Two kinds of processor are compiled for, by the names that compilers share: x86-64-v4 (AVX-512) and x86-64-v3 (AVX2
and FMA).  A computer takes the first that it can run.  The digest is that of all that a kernel is compiled from
(`kernel_cache`): after an edit, or with another numba, nothing fits, and kernels are compiled as without a wheel.

What this computer has compiled for itself (``rtpiv setup warm``) is preferred: it is a little faster, and gives
the same bits, because the kinds differ in how many operations are done at once and not in which.
"""

import platform
from functools import cache
from pathlib import Path

FOLDER = Path(__file__).with_name("machine_code")
MADE_BY = "numba-"
_V3 = ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")
KINDS = {  # best first -> what a processor must have, as LLVM calls it
    "x86-64-v4": (*_V3, "avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"),
    "x86-64-v3": _V3,
}


@cache
def wheel_folder(version: str, folder: Path) -> Path | None:
    """Return the folder of the best code for this processor that a version of numba has made; None without any.

    Parameters
    ----------
    version : str
        Of the numba that would run it.
    folder : path
        What came with the wheel.
    """
    made = folder / f"{MADE_BY}{version}"
    if not made.is_dir() or platform.machine().lower() not in ("x86_64", "amd64"):
        return None
    from llvmlite.binding import get_host_cpu_features  # imported by now, because a kernel is called

    has = get_host_cpu_features()
    fits = (made / kind for kind, wants in KINDS.items() if all(map(has.get, wants)))
    return next((kind for kind in fits if kind.is_dir()), None)


def other_numba(version: str, folder: Path) -> str | None:
    """Return the version that the code of this wheel was made by, if it is another one."""
    made_by = sorted(path.name.removeprefix(MADE_BY) for path in folder.glob(f"{MADE_BY}*"))
    return made_by[-1] if made_by and version not in made_by else None
