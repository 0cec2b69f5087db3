"""The evaluators that `benchmarks.piv` compares: a script each, and how one is run in a process of its own."""

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

Array = Any  # numpy arrays of the benchmark
Pair = list[Array]
Field = dict[str, Array]
Contenders = dict[str, tuple[str, str, str]]

OWN = """
import sys, time, json, numpy as np
from functools import partial
from piv.correlation.live import live_vectors
from piv.correlation.pair import evaluate_pair
from piv.correlation.settings import PivSettings
a, b, out, rounds, mode = np.load(sys.argv[1]), np.load(sys.argv[2]), sys.argv[3], int(sys.argv[4]), sys.argv[5]
settings = {
    "": PivSettings(),
    "16": PivSettings(windows_px=(64, 32, 16, 16, 16)),
    "75": PivSettings(overlap=0.75),
}.get(mode)
measure = partial(evaluate_pair, settings=settings) if settings else live_vectors
times = []
for _ in range(rounds + 1):
    start = time.process_time()
    f = measure(a, b, threads=1)
    times.append(time.process_time() - start)
x, y = np.meshgrid(f.x_px, f.y_px)
sigma_u, sigma_v = np.moveaxis(f.total_sigma_px, -1, 0)
np.savez(out, x=x, y=y, u=f.u_px, v=f.v_px, sigma_u=sigma_u, sigma_v=sigma_v)
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

EXACT = PIVTOOLS.replace('"square", peak_finder="gauss3"', '"gaussian", peak_finder="gauss6"')
TO_16 = {
    "openpiv": OPENPIV.replace("(64, 32, 32, 32), (32, 16, 16, 16)", "(64, 32, 16, 16), (32, 16, 8, 8)"),
    "pivtools exact": EXACT.replace("[32, 32], [32, 32]]", "[16, 16], [16, 16]]").replace(
        "15.5 + 16 * np.arange", "7.5 + 8 * np.arange"
    ),
}
SCRIPTS = {"openpiv": OPENPIV, "fluidimage": FLUIDIMAGE, "pivtools": PIVTOOLS, "pivtools exact": EXACT}
SINGLE = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")


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
