"""PIV against its open peers: accuracy, speed, and agreement on real pairs, in one run on the same cores.

    python -m benchmarks.piv [-o FOLDER] [--peer openpiv=PYTHON] [--peer fluidimage=...] [--peer pivtools=...]

PYTHON is the interpreter of an environment in which that peer is installed; a peer without one is skipped by
name.  Peers run in processes of their own, one thread each, and are tools of this benchmark only.  Every
contender gets the same frames as .npy files, passes 64, 32, 32, 32 px at 50 % overlap (fluidimage, which shifts
windows instead of deforming them: 64, 32, 32), and reports process CPU time without start-up and compilation.
"""

import argparse
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

Array = Any  # numpy arrays of the benchmark
Pair = list[Array]
Field = dict[str, Array]
Truth = Callable[[Array, Array], tuple[Array, Array]]
Contenders = dict[str, tuple[str, str, str]]
Table = dict[str, Any]

ROOT = Path(__file__).resolve().parents[1]
ROUNDS = 5  # interleaved, so that a busy neighbour hits everyone

OWN = """
import sys, time, json, numpy as np
from correction.evaluate.piv import evaluate_pair
from correction.evaluate.settings import PivSettings
a, b, out, rounds, mode = np.load(sys.argv[1]), np.load(sys.argv[2]), sys.argv[3], int(sys.argv[4]), sys.argv[5]
settings = PivSettings(uncertainty=mode == "sigma")
times = []
for _ in range(rounds + 1):
    start = time.process_time()
    f = evaluate_pair(a, b, settings=settings, threads=1)
    times.append(time.process_time() - start)
x, y = np.meshgrid(f.x_px, f.y_px)
np.savez(out, x=x, y=y, u=f.u_px, v=f.v_px)
print(json.dumps(times[1:]))
"""

OPENPIV = """
import sys, time, json, os, contextlib, numpy as np
from openpiv import windef
from openpiv.settings import PIVSettings
a, b = (np.load(file).astype(float) for file in sys.argv[1:3])
out, rounds = sys.argv[3], int(sys.argv[4])
s = PIVSettings()
s.windowsizes, s.overlap, s.num_iterations = (64, 32, 32, 32), (32, 16, 16, 16), 4
s.show_all_plots = s.show_plot = s.save_plot = False
times = []
with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
    for _ in range(rounds):
        start = time.process_time()
        x, y, u, v, flags = windef.simple_multipass(a, b, s)
        times.append(time.process_time() - start)
# It returns y up and v up, counted from the lowest row of windows, and w/2 for the first centre.
np.savez(out, x=x - 0.5, y=np.sort(y[:, 0])[:, None] + 0 * x - 0.5, u=u, v=-v)
print(json.dumps(times))
"""

FLUIDIMAGE = """
import sys, time, json, numpy as np
from fluidimage.works.piv import WorkPIV
from fluidimage.data_objects.piv import ArrayCouple
p = WorkPIV.create_default_params()
p.piv0.shape_crop_im0, p.piv0.method_subpix, p.piv0.nsubpix, p.piv0.displacement_max = 64, "2d_gaussian", 1, 16
p.multipass.number, p.multipass.use_tps, p.multipass.coeff_zoom = 3, False, [2, 1]
a, b, out, rounds = np.load(sys.argv[1]), np.load(sys.argv[2]), sys.argv[3], int(sys.argv[4])
work, times = WorkPIV(p), []
for _ in range(rounds + 1):
    start = time.process_time()
    result = work.calcul(ArrayCouple(names=("a", "b"), arrays=(a, b)))
    times.append(time.process_time() - start)
last = result.piv_results[-1] if hasattr(result, "piv_results") else result.passes[-1]
np.savez(out, x=last.xs - 0.5, y=last.ys - 0.5, u=last.deltaxs, v=last.deltays)
print(json.dumps(times[1:]))
"""

PIVTOOLS = """
import sys, time, json, logging, tempfile, numpy as np, yaml
from pathlib import Path
logging.disable(logging.CRITICAL)
from pivtools_core.config import Config
from pivtools_cli.piv.piv_backend.cpu_instantaneous import InstantaneousCorrelatorCPU
a, b, out, rounds = np.load(sys.argv[1]), np.load(sys.argv[2]), sys.argv[3], int(sys.argv[4])
sizes = [[64, 64], [32, 32], [32, 32], [32, 32]]
piv = dict(window_size=sizes, overlap=[50] * 4, window_type="square", peak_finder="gauss3",
           image_warp_interpolation="lanczos", runs=[4])
median = dict(type="median_2d", epsilon=0.1, threshold=2)
settings = dict(images={}, paths={}, processing=dict(omp_threads=1, backend="cpu"), instantaneous_piv=piv,
                outlier_detection=dict(enabled=True, methods=[median]),
                infilling=dict(mid_pass=dict(method="nearest", parameters={}), final_pass=dict(enabled=False)))
file = Path(tempfile.mkdtemp()) / "config.yaml"
file.write_text(yaml.dump(settings))
config = Config(file)
config._detected_image_shape = a.shape
correlator, pair, times = InstantaneousCorrelatorCPU(config), np.stack([a, b])[None].astype(np.float32), []
for _ in range(rounds + 1):
    start = time.process_time()
    result = correlator.correlate_batch(pair, config)
    times.append(time.process_time() - start)
while isinstance(result, list):
    result = result[-1]
last = result.passes[-1]
while isinstance(last, list):
    last = last[-1]
u, v = np.squeeze(last.ux_mat), np.squeeze(last.uy_mat)
x, y = np.meshgrid(15.5 + 16 * np.arange(u.shape[1]), 15.5 + 16 * np.arange(u.shape[0]))
np.savez(out, x=x, y=y, u=u, v=v)
print(json.dumps(times[1:]))
"""

SCRIPTS = {"openpiv": OPENPIV, "fluidimage": FLUIDIMAGE, "pivtools": PIVTOOLS}
SINGLE = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")


def generator() -> Callable[..., Pair]:
    """Return the pair generator of the tests, which shares nothing with the evaluator."""
    file = ROOT / "tests" / "correction" / "evaluate" / "conftest.py"
    spec = importlib.util.spec_from_file_location("particle_pairs", file)
    if spec is None or spec.loader is None:
        raise FileNotFoundError(file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.make_pair


def run(
    python: str, script: str, pair: Pair, folder: Path, rounds: int, mode: str = ""
) -> tuple[list[float], Field]:
    """Evaluate a pair in a process of its own: CPU seconds of each round, and the field."""
    files = []
    for name, frame in zip("ab", pair, strict=True):
        files.append(str(folder / f"{name}.npy"))
        np.save(files[-1], frame)
    out = folder / "field.npz"
    # In the folder that is thrown away: some peers write logs where they run.
    environment = {**os.environ, **SINGLE}
    done = subprocess.run(
        [python, "-c", script, *files, str(out), str(rounds), mode],
        capture_output=True,
        text=True,
        env=environment,
        cwd=folder,
    )
    if done.returncode:
        raise RuntimeError(done.stderr.strip().splitlines()[-1])
    with np.load(out) as field:
        return json.loads(done.stdout.strip().splitlines()[-1]), {name: field[name] for name in field.files}


def truths(size: int) -> dict[str, Truth]:
    """Displacement fields of the accuracy table; `size` is the frame's side [px]."""
    c = size / 2
    return {
        "uniform 9.9": lambda u, v: (9.9 + 0 * u, 9.9 + 0 * u),
        "rotation 0.02": lambda u, v: (-0.02 * (v - c), 0.02 * (u - c)),
        "shear 0.025": lambda u, v: (0.025 * (v - c), 0 * u),
        "wave 3 px, 200 px": lambda u, v: (3 * np.sin(2 * np.pi * v / 200), 3 * np.sin(2 * np.pi * u / 200)),
    }


def error(field: Field, truth: Truth, size: int, margin: int = 48) -> tuple[Array, Array]:
    """Errors of both components [px] away from the frame's edge."""
    du, dv = truth(field["x"], field["y"])
    x, y = field["x"], field["y"]
    inner = (x > margin) & (x < size - margin) & (y > margin) & (y < size - margin)
    return (field["u"] - du)[inner], (field["v"] - dv)[inner]


def accuracy(contenders: Contenders, folder: Path, make_pair: Callable[..., Pair], size: int = 1024) -> Table:
    """Bias and rms error [px] of each contender, and the largest bias between 0 and 1 px."""
    table = {name: {} for name in contenders}
    for case, truth in truths(size).items():
        pair = make_pair(truth, (size, size), seed=1)
        for name, (python, script, mode) in contenders.items():
            eu, ev = error(run(python, script, pair, folder, 1, mode)[1], truth, size)
            both = np.concatenate([eu.ravel(), ev.ravel()])
            table[name][case] = {
                "bias_px": float(np.nanmean(both)),
                "rms_px": float(np.sqrt(np.nanmean(both**2))),
                "outliers": int(np.count_nonzero(~(np.abs(both) < 0.5))),
            }
    biases = {name: [] for name in contenders}
    for step in range(11):
        shift = step / 10

        def truth(u: Array, v: Array, shift: float = shift) -> tuple[Array, Array]:
            return shift + 0 * u, shift + 0 * v

        pair = make_pair(truth, (512, 512), seed=step)
        for name, (python, script, mode) in contenders.items():
            eu, ev = error(run(python, script, pair, folder, 1, mode)[1], truth, 512)
            biases[name] += [abs(float(np.nanmean(eu))), abs(float(np.nanmean(ev)))]
    for name, values in biases.items():
        table[name]["sweep 0-1 px"] = {"max_bias_px": max(values)}
    return table


def speed(contenders: Contenders, folder: Path, make_pair: Callable[..., Pair], size: int = 2016) -> Table:
    """CPU seconds per pair, interleaved rounds: median and minimum."""
    pair = make_pair(lambda u, v: (5.3 - 0.004 * (v - 1000), 3.7 + 0.004 * (u - 1000)), (size, size), seed=2)
    times = {name: [] for name in contenders}
    for _ in range(ROUNDS):
        for name, (python, script, mode) in contenders.items():
            times[name].append(min(run(python, script, pair, folder, 2, mode)[0]))
    return {name: {"median_s": float(np.median(t)), "min_s": min(t)} for name, t in times.items()}


def real_pairs(contenders: Contenders, folder: Path) -> Table:
    """Median difference [px] of each peer from ours on the real pairs, where those are at hand."""
    import cv2

    at = ROOT.parent / "shared" / "piv_pairs"
    names = {"pivch2001A": "tif", "pivch2001B": "tif", "pivlab_karman": "bmp", "openpiv_exp1_001": "bmp"}
    table = {}
    for name in names:
        files = sorted(at.glob(name + "_*"))
        if len(files) != 2:
            print(f"skipped: real pair {name} is not in {at.name}/")
            continue
        pair = [cv2.imread(str(file), cv2.IMREAD_GRAYSCALE) for file in files]
        # sides that windows of all passes divide, so that everyone's grid is the same
        rows, columns = (side // 64 * 64 for side in pair[0].shape)
        pair = [np.ascontiguousarray(frame[:rows, :columns]) for frame in pair]
        own = run(*contenders["rtpiv"][:2], pair, folder, 1)[1]
        nodes = {(x, y): k for k, (x, y) in enumerate(zip(own["x"].flat, own["y"].flat, strict=True))}
        table[name] = {}
        for peer, (python, script, mode) in contenders.items():
            if peer.startswith("rtpiv"):
                continue
            other = run(python, script, pair, folder, 1, mode)[1]
            table[name][peer] = difference(own, other, nodes)
    return table


def difference(own: Field, other: Field, nodes: dict[tuple[float, float], int]) -> dict[str, float] | None:
    """Median length of the difference [px] at common nodes, or None where grids do not meet."""
    at = [(k, nodes.get((x, y))) for k, (x, y) in enumerate(zip(other["x"].flat, other["y"].flat, strict=True))]
    theirs, ours = np.array([(k, n) for k, n in at if n is not None], int).reshape(-1, 2).T
    if not len(ours):
        return None
    gap = [other[c].ravel()[theirs] - own[c].ravel()[ours] for c in "uv"]
    return {"median_px": float(np.nanmedian(np.hypot(*gap))), "vectors": len(ours)}


def main() -> None:
    """Run what can be run and print one JSON document."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, help="folder for piv.json")
    parser.add_argument("--peer", action="append", default=[], metavar="NAME=PYTHON")
    parser.add_argument("--only", choices=["accuracy", "speed", "real"], action="append")
    arguments = parser.parse_args()
    peers = dict(item.split("=", 1) for item in arguments.peer)
    contenders = {"rtpiv": (sys.executable, OWN, ""), "rtpiv with sigma": (sys.executable, OWN, "sigma")}
    for name, script in SCRIPTS.items():
        if name in peers:
            contenders[name] = (peers[name], script, "")
        else:
            print(f"skipped: {name}, no --peer {name}=PYTHON given", file=sys.stderr)
    parts = arguments.only or ["accuracy", "speed", "real"]
    result = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if "speed" in parts:
            result["speed"] = speed(contenders, folder, generator())
        if "accuracy" in parts:
            result["accuracy"] = accuracy(contenders, folder, generator())
        if "real" in parts:
            result["real"] = real_pairs(contenders, folder)
    text = json.dumps(result, indent=2)
    print(text)
    if arguments.output:
        arguments.output.mkdir(parents=True, exist_ok=True)
        (arguments.output / "piv.json").write_text(text + "\n")


if __name__ == "__main__":
    main()
