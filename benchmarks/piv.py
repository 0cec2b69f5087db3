"""PIV against its open peers: accuracy, speed, and agreement on real pairs, in one run on the same cores.

    python -m benchmarks.piv [-o FILE] [--peer openpiv=PYTHON fluidimage=... pivtools=...]
    python -m benchmarks.piv --only cases --case 'wave *' 'dead *'

PYTHON is the interpreter of an environment in which that peer is installed; a peer without one is skipped by
name.  Peers run in processes of their own, one thread each, and are tools of this benchmark only.  Every
contender gets the same frames as .npy files, passes 64, 32, 32, 32 px at 50 % overlap (fluidimage, which shifts
windows instead of deforming them: 64, 32, 32), and reports process CPU time without start-up and compilation.
PIVTOOLs comes twice: as it is fastest, and as it is most exact (Gaussian windows, fit of six points).  The flows
are those of the evaluator's tests: waves of 24 to 256 px, turbulence with Kolmogorov's spectrum, and what makes
images hard.
"""

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.options import keep, options
from benchmarks.piv_cases import ROOT, Table, Truth, generator, hard_cases
from benchmarks.piv_contenders import OWN, SCRIPTS, Array, Contenders, Field, Pair, run

ROUNDS = 5  # interleaved, so that a busy neighbour hits everyone


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
    asked = options(__doc__, peer=[], only=["speed", "accuracy", "cases", "real"], case=["*"])
    peers = dict(item.split("=", 1) for item in asked.peer)
    contenders = {"rtpiv": (sys.executable, OWN, "")}
    for name, script in SCRIPTS.items():
        if name.split()[0] in peers:
            contenders[name] = (peers[name.split()[0]], script, "")
        else:
            print(f"skipped: {name}, no --peer {name}=PYTHON given", file=sys.stderr)
    result = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if "speed" in asked.only:
            modes = {
                "rtpiv, 75 % overlap": (sys.executable, OWN, "75"),
                "rtpiv, live": (sys.executable, OWN, "live"),
            }
            result["speed"] = speed(contenders | modes, folder, generator())
        if "accuracy" in asked.only:
            result["accuracy"] = accuracy(contenders, folder, generator())
        if "cases" in asked.only:
            result["cases"] = hard_cases(contenders, folder, generator(), asked.case)
        if "real" in asked.only:
            result["real"] = real_pairs(contenders, folder)
    keep(result, asked.out)


if __name__ == "__main__":
    main()
