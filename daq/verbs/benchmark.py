"""`rtpiv benchmark`: run time against error on this machine, for one scene; the project's own benchmark."""

import subprocess
from pathlib import Path

from daq.child import child
from daq.errors import DaqError
from tracer.scene_file import load_scene


def benchmark(scene: Path, out: Path, rounds: int = 9) -> None:
    """Measure ray map, correction map and frames of a scene beside the peers that are installed.

    The benchmark judges the packages against 50-digit references and other programs, so it stands outside of them
    and is run as a program of its own; ``make benchmark`` runs the same for the scenes of the paper.

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
        The benchmark stopped; what it printed says why.
    """
    load_scene(scene)
    options = ["-o", str(out.resolve()), "--rounds", str(rounds), "--scenes", str(scene.resolve())]
    command, environment = child("benchmarks", *options)
    if subprocess.run(command, env=environment, check=False).returncode:
        raise DaqError("the benchmark stopped; what it said last tells why")
