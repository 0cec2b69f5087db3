"""`rtpiv benchmark`: run time against error on this machine, for one scene; the project's own benchmark."""

import os
import subprocess
from importlib.util import find_spec
from pathlib import Path

from daq.child import child
from daq.errors import DaqError, RunUsageError
from rtpiv.options.numbers import Count
from rtpiv.verbs.paths import Named
from rtpiv.verbs.results import results_in
from tracer.scene.scene_file import load_scene


def benchmark(scene: Named, /, out: Named = "benchmark", rounds: Count = 9) -> Path:
    """Measure ray map, correction map and frames of a scene beside the peers that are installed.

    The benchmark judges the packages against 50-digit references and other programs, so it stands outside of them
    and is run as a program of its own; ``make benchmark`` runs the same for the scenes of the paper.

    Parameters
    ----------
    scene : path
        scene.yaml.
    out : path
        Folder for ``benchmark.json`` and ``benchmark.png``.
    rounds : int
        Interleaved rounds.

    Returns
    -------
    Path
        ``benchmark.json``.

    Raises
    ------
    ConfigError
        The scene file is wrong.
    RunUsageError
        The benchmarks are not there: they stand in the sources, and are not installed.
    DaqError
        The benchmark stopped; what it printed says why.
    """
    scene, out = Path(scene), Path(out)
    load_scene(scene)
    if find_spec("benchmarks") is None:
        raise RunUsageError("the benchmarks are not installed: run this in a checkout of the sources of rtpiv")
    options = ["-o", os.path.realpath(out), "--rounds", str(rounds), "--scenes", os.path.realpath(scene)]
    command, environment = child("benchmarks", *options)
    with results_in(out):
        if subprocess.run(command, env=environment, check=False).returncode:
            raise DaqError("the benchmark stopped; what it said last tells why")
    return out / "benchmark.json"
