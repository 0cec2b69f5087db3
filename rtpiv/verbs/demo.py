"""`rtpiv demo`: run a simulated campaign through two glass balls."""

import shutil
from pathlib import Path

from daq.bench.bench_file import load_bench
from daq.bench.opened import require_camera_libraries
from daq.runs.run_views import target_views
from ground.terminal import console
from rtpiv.analysis.recipe import CorrectionRecipe
from rtpiv.analysis.series.series_folder import FILE as SERIES
from rtpiv.example_files import examples
from rtpiv.verbs.acquire import LiveFrames, acquire
from rtpiv.verbs.calibrate import calibrate
from rtpiv.verbs.correct import correct
from rtpiv.verbs.mean import mean
from rtpiv.verbs.paths import Named
from rtpiv.verbs.report import report
from rtpiv.verbs.results import results_in
from rtpiv.verbs.trace import trace


def demo(out: Named = "demo") -> Path:
    """Acquire, find the true geometry, correct, measure a known shift and a jet, all on the simulated bench.

    The bench is misaligned by a few tenths of a millimetre, and nothing but its frames says how.

    Parameters
    ----------
    out : path
        Folder, with ``trace/``: field of view; ``runs/``: a target run and a shift run, corrected as the frames
        arrived; ``nominal/``: the target corrected with the nominal scene; ``fit/``: the calibration; ``fitted/``:
        the target corrected with the fitted scene; ``report/``: page and vectors; ``flow/``: mean of a
        jet.  Results of an earlier demo are replaced, except its runs.

    Returns
    -------
    Path
        The page of the shift run.

    Raises
    ------
    CameraSetupError
        Libraries of the camera are not installed.
    """
    files, screen = examples() / "demo", console()
    require_camera_libraries(load_bench(files / "bench.yaml"), simulate=True)
    with results_in(out) as out:
        scene, bench, fitted = files / "scene.yaml", files / "bench.yaml", out / "fit" / "scene.yaml"
        screen.rule("1  what two glass balls do to the view")
        trace(scene, out / "trace")
        screen.rule("2  target run: stages and camera by their real protocols")
        targets = acquire(files / "plan-target.yaml", bench, out / "runs", simulate=True, home=True)
        assert targets is not None
        frames = {view.tag: view.path for view in target_views(targets)}
        screen.rule("3  corrected as known: everything is a few tenths of a millimetre off")
        correct(
            [frames["target_glass"]],
            scene,
            out / "nominal",
            CorrectionRecipe(frames["target_clear"]),
            check_target=True,
        )
        screen.rule("4  the true geometry, found from the target's own frames")
        calibrate(targets, None, out / "fit")
        screen.rule("5  corrected with the geometry found")
        correct([frames["target_glass"]], fitted, out / "fitted", check_target=True)
        screen.rule("6  shift run: printed particles moved by 14 px, corrected as the frames arrive")
        moved = acquire(
            files / "plan-shift.yaml",
            bench,
            out / "runs",
            simulate=True,
            home=True,
            frames=LiveFrames(scene=fitted),
        )
        assert moved is not None
        screen.rule("7  the displacement, measured through the glass, and the report")
        page = report(moved, out / "report", fitted)
        screen.rule("8  a jet, lit by a double-pulse laser: background, two dozen pairs, their mean")
        plan, lit = files / "plan-flow.yaml", files / "bench-flow.yaml"
        flow = acquire(
            plan, lit, out / "runs", simulate=True, home=True, operator="demo", frames=LiveFrames(scene=fitted)
        )
        assert flow is not None
        if (out / "flow" / SERIES).exists():  # of an earlier demo: `mean` never replaces vectors of another run
            shutil.rmtree(out / "flow")
        mean(flow, out / "flow", scene=fitted)
        screen.print(
            f"Look at {page}, {out / 'flow' / 'mean.html'}, {out / 'fitted' / 'overview.png'} and {out / 'trace'}",
            style="bold",
        )
        return page
