"""`rtpiv bench`: run time against error on this machine, for one scene; the benchmark of the project itself."""

import subprocess
import sys
from pathlib import Path

from daq.errors import DaqError
from tracer.scene_file import load_scene

CHECKOUT = Path(__file__).resolve().parents[2]


def bench(scene: Path, out: Path, rounds: int = 9) -> None:
    """Measure ray map, correction map and frames of a scene beside the peers that are installed.

    The benchmark judges the packages against 50-digit references and other programs, so it stands outside of them,
    with the tests; this verb runs the same code as ``make bench``.

    Parameters
    ----------
    scene : Path
        scene.yaml.
    out : Path
        Folder for ``benchmark.json`` and ``benchmark.png``.
    rounds : int
        Interleaved rounds.

    Raises
    ------
    ConfigError
        The scene file is wrong.
    DaqError
        There is no checkout of the project around the program, or the benchmark failed.
    """
    if not (CHECKOUT / "benchmarks" / "__main__.py").is_file():
        raise DaqError(f"{CHECKOUT / 'benchmarks'} is missing; run bench from a checkout of the project")
    load_scene(scene)
    options = ["-o", str(out.resolve()), "--rounds", str(rounds), "--scenes", str(scene.resolve())]
    if subprocess.run([sys.executable, "-m", "benchmarks", *options], cwd=CHECKOUT, check=False).returncode:
        raise DaqError("the benchmark stopped; what it said last tells why")
