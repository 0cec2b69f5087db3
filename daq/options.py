"""The verbs of the command line and their options; nothing is imported for them: ``--help`` answers at once."""

import argparse
import math
from pathlib import Path

PICTURES = {  # what a verb draws when all else is written and said
    "trace": "the pictures",
    "calibrate": "the pictures",
    "correct": "the overview",
    "evaluate": "the page",
}


class _Version(argparse.Action):
    """Looked up only when asked for: the library that knows it is slow to import."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        print(f"rtpiv {version('rtpiv')}")
        parser.exit()


def parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    words = argparse.ArgumentParser(
        prog="rtpiv", description="Particle image velocimetry through glass: acquire, trace, correct, prove."
    )
    words.add_argument("--version", action=_Version, nargs=0, default=argparse.SUPPRESS, help="say which and end")
    words.add_argument("--threads", type=_count, metavar="N", help="cores to use (default: all)")
    verbs = words.add_subparsers(dest="verb", metavar="VERB", required=True)

    _first_verbs(verbs)

    trace = verbs.add_parser("trace", help="what a scene shows: recovered field of view, folds, pictures")
    trace.add_argument("scene", type=Path, metavar="SCENE", help="scene.yaml")
    trace.add_argument(
        "-o", "--out", type=Path, default=Path("trace"), help="folder for pictures (default: trace)"
    )

    calibrate = verbs.add_parser("calibrate", help="the bench's true geometry from frames of its target")
    calibrate.add_argument(
        "folder",
        type=Path,
        metavar="FOLDER",
        help="a target run, or target_clear.tif and target_glass.tif",
    )
    calibrate.add_argument(
        "--scene", type=Path, help="nominal scene.yaml; may have a fit section (default: the run's own)"
    )
    calibrate.add_argument(
        "-o", "--out", type=Path, default=Path("fit"), help="folder for scene and report (default: fit)"
    )
    calibrate.add_argument("--square-mm", type=_positive, help="square of the board; a run knows it (default 2.5)")
    calibrate.add_argument("--disc-mm", type=_positive, help="its discs; a run knows it (default 1.0)")

    correct = verbs.add_parser("correct", help="frames as if the glass were not there")
    correct.add_argument(
        "frames",
        type=Path,
        nargs="+",
        metavar="FRAME",
        help="acquired frames (.tif, .png, .bmp; page 2 of a stack: stack.tif@2)",
    )
    correct.add_argument("--scene", type=Path, required=True, help="scene.yaml")
    correct.add_argument("-o", "--out", type=Path, default=Path("corrected"), help="folder (default: corrected)")
    correct.add_argument("--target-clear", type=Path, metavar="T", help="bare target, for the dewarp")
    correct.add_argument("--dewarp-order", type=int, choices=(2, 3, 4, 5), default=2, help="its order")
    correct.add_argument("--square-mm", type=_positive, help="square of the board; a run knows it (default 2.5)")
    correct.add_argument("--disc-mm", type=_positive, help="its discs; a run knows it (default 1.0)")
    correct.add_argument("--method", choices=("quintic", "bilinear"), default="quintic", help="interpolation")
    correct.add_argument("--blend", type=_count, default=1, metavar="K", help="join the K best views of a node")
    correct.add_argument("--float", dest="as_float", action="store_true", help="write float32, not offset uint16")
    _sigma_limit_option(correct)
    correct.add_argument("--check-target", action="store_true", help="frames show the target: report its errors")

    evaluate = verbs.add_parser("evaluate", help="vectors of a pair seen through glass, with a report")
    evaluate.add_argument("paths", type=Path, nargs="+", metavar="PATH", help="frame A and frame B, or one run")
    evaluate.add_argument("--scene", type=Path, help="scene.yaml, best a fitted one (default: the run's own)")
    evaluate.add_argument(
        "-o", "--out", type=Path, default=Path("evaluation"), help="folder (default: evaluation)"
    )
    evaluate.add_argument("--target-clear", type=Path, metavar="T", help="bare target, for the dewarp")
    evaluate.add_argument("--dewarp-order", type=int, choices=(2, 3, 4, 5), default=2, help="its order")
    evaluate.add_argument("--square-mm", type=_positive, help="square of the board; a run knows it (default 2.5)")
    evaluate.add_argument("--disc-mm", type=_positive, help="its discs; a run knows it (default 1.0)")
    evaluate.add_argument("--shift-mm", type=_finite, nargs=2, metavar=("X", "Y"), help="true shift, y up")
    evaluate.add_argument(
        "--stage-sigma-um", type=_positive, default=10.0, help="standard error of the stage (default 10)"
    )
    _route_option(evaluate, "image")
    _sigma_limit_option(evaluate)
    evaluate.add_argument(
        "--tracking", action="store_true", help="also follow single particles, where seeding is thin (tracks.nc)"
    )
    evaluate.add_argument("--vtk", action="store_true", help="also write VTK text")
    evaluate.add_argument("--figures", action="store_true", help="write each figure as SVG and as PNG")
    _series_options(evaluate)
    _piv_options(evaluate)

    focus = verbs.add_parser("focus", help="where a view through glass is sharp, and which f-number it needs")
    focus.add_argument("run", type=Path, metavar="RUN", help="run of a plan of experiment: focus")
    focus.add_argument("-o", "--out", type=Path, help="folder for its page (default: the run's)")

    sheet = verbs.add_parser("sheet", help="where the light sheet is, from particles that are seen twice")
    sheet.add_argument("paths", type=Path, nargs="+", metavar="PATH", help="flow run, or frames A, B, A, B ...")
    sheet.add_argument("--scene", type=Path, required=True, help="scene.yaml, fitted")
    sheet.add_argument("-o", "--out", type=Path, default=Path("sheet"), help="folder (default: sheet)")

    join = verbs.add_parser("join", help="one mean of two runs of a flow, focused beside the glass and behind it")
    join.add_argument("beside", type=Path, metavar="SERIES_BESIDE", help="series of the run focused on the plane")
    join.add_argument(
        "behind", type=Path, metavar="SERIES_BEHIND", help="series of the run focused behind the glass"
    )
    join.add_argument("-o", "--out", type=Path, default=Path("joined"), help="folder (default: joined)")

    mean = verbs.add_parser("mean", help="mean flow, Reynolds stresses and their uncertainty from many pairs")
    mean.add_argument("path", type=Path, metavar="RUN_OR_SERIES", help="flow run, or the folder of its series")
    mean.add_argument("--scene", type=Path, help="scene.yaml, best a fitted one (default: the run's own)")
    mean.add_argument("-o", "--out", type=Path, help="folder of the series (default: RUN/series)")
    mean.add_argument("--target-clear", type=Path, metavar="T", help="bare target, for the dewarp")
    mean.add_argument("--dewarp-order", type=int, choices=(2, 3, 4, 5), default=2, help="its order")
    mean.add_argument("--figures", action="store_true", help="write each figure as SVG and as PNG")
    mean.add_argument(
        "--ensemble", type=int, choices=(8, 16, 32), metavar="PX",
        help="also by ensemble correlation, windows of 8, 16 or 32 px: for rims, walls, thin seeding",
    )  # fmt: skip
    _sigma_limit_option(mean)
    _series_options(mean)
    _piv_options(mean)

    report = verbs.add_parser("report", help="a run as one page: pictures, vectors, errors, books, provenance")
    report.add_argument("run", type=Path, metavar="RUN", help="folder of the run")
    report.add_argument("--scene", type=Path, help="scene.yaml, best a fitted one (default: the run's own)")
    report.add_argument("-o", "--out", type=Path, help="folder for the page (default: RUN/report)")
    report.add_argument("--target-clear", type=Path, metavar="T", help="bare target, for the dewarp")
    report.add_argument("--dewarp-order", type=int, choices=(2, 3, 4, 5), default=2, help="its order")
    report.add_argument(
        "--stage-sigma-um", type=_positive, default=10.0, help="standard error of the stage (default 10)"
    )
    _route_option(report, "compare")
    _piv_options(report)

    _bench_verbs(verbs)

    benchmark = verbs.add_parser("benchmark", help="run time against error on this machine, for one scene")
    benchmark.add_argument("scene", type=Path, metavar="SCENE", help="scene.yaml")
    benchmark.add_argument("-o", "--out", type=Path, default=Path("benchmark"), help="folder for its files")
    benchmark.add_argument("--rounds", type=_count, default=9, help="interleaved rounds (default 9)")

    demo = verbs.add_parser("demo", help="see through simulated glass, from frames to pictures")
    demo.add_argument("-o", "--out", type=Path, default=Path("demo"), help="folder for everything (default: demo)")
    for name, left_out in PICTURES.items():
        verbs.choices[name].add_argument(
            "--no-pictures", dest="pictures", action="store_false", help=f"leave out {left_out}"
        )
    for verb in verbs.choices.values():  # before the verb or behind it
        verb.add_argument(
            "--threads", type=_count, metavar="N", default=argparse.SUPPRESS, help="cores to use (default: all)"
        )
    return words


def _first_verbs(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Verbs of the first hour."""
    init = verbs.add_parser("init", help="write scene, bench and plan files for a lab; asks, or takes options")
    init.add_argument(
        "folder", type=Path, nargs="?", default=Path(), metavar="FOLDER", help="where (default: here)"
    )
    init.add_argument("--yes", dest="ask", action="store_false", help="ask nothing, take what is usual")
    init.add_argument("--overwrite", action="store_true", help="replace files that are there")
    init.add_argument("--name", help="of the bench: letters, digits, underscores (default lab)")
    init.add_argument("--sensor-px", type=_count, nargs=2, metavar=("W", "H"), help="frames of the camera")
    init.add_argument("--pixel-pitch-um", type=_positive, metavar="UM", help="size of a pixel (default 4.8)")
    init.add_argument("--lens-mm", type=_positive, metavar="MM", help="focal length (default 50)")
    init.add_argument(
        "--distance-mm", type=_positive, metavar="MM", help="from the lens to the plane (default 500)"
    )
    init.add_argument("--balls", type=_count, metavar="N", help="how many (default 1)")
    init.add_argument(
        "--arrangement", choices=("row", "side", "triangle", "pyramid"),
        help="one behind the other, beside each other, ... (default: row; triangle of 3, pyramid of 4 or 5)",
    )  # fmt: skip
    init.add_argument("--ball-mm", type=_positive, metavar="MM", help="diameter of a ball (default 40)")
    init.add_argument(
        "--glass", metavar="NAME", help="of the balls: acrylic, BK7, borosilicate ... (default acrylic)"
    )
    init.add_argument("--gap-mm", type=_finite, metavar="MM", help="from the plane to the lowest ball (default 4)")
    init.add_argument(
        "--support-mm", type=_finite, metavar="MM", help="diameter of steel rods that hold them (default 0)"
    )
    init.add_argument("--wavelength-nm", type=_positive, metavar="NM", help="of the light (default 532)")

    examples = verbs.add_parser("examples", help="copy the example scenes, benches and plans into a folder")
    examples.add_argument("out", type=Path, nargs="?", default=Path("examples"), metavar="FOLDER", help="where to")

    schema = verbs.add_parser("schema", help="JSON schemas of the three files, for editors")
    schema.add_argument("-o", "--out", type=Path, default=Path("schemas"), help="folder (default: schemas)")

    verbs.add_parser("warm", help="compile now what first commands would wait for: for images and clusters")

    completion = verbs.add_parser("completion", help="completion of verbs and options for a shell")
    completion.add_argument("shell", choices=("bash", "zsh", "fish"))


def _piv_options(parser: argparse.ArgumentParser) -> None:
    """How pairs are correlated; each wins over the file."""
    piv = parser.add_argument_group("correlation", "docs/files.md says more; the page shows what they trade")
    piv.add_argument("--piv", type=Path, metavar="FILE", help="YAML file with all settings")
    piv.add_argument("--first-window", type=_count, metavar="PX", help="side of the first windows (default 64)")
    piv.add_argument("--final-window", type=_count, metavar="PX", help="side of the last windows (default 32)")
    piv.add_argument("--passes", type=_count, metavar="N", help="passes (default 4)")
    piv.add_argument("--overlap", type=_finite, metavar="SHARE", help="of neighbouring windows (default 0.5)")
    piv.add_argument("--window", choices=("gaussian", "square"), help="weights of the windows (default gaussian)")
    piv.add_argument(
        "--prepare",
        type=_steps,
        metavar="STEPS",
        help="what is done to frames, such as sliding-minimum,min-max (the default of a flow run is "
        "sliding-minimum), or none",
    )
    piv.add_argument("--denoise", type=_finite, metavar="BETA", help="0 keeps all detail (default 2)")


def _series_options(parser: argparse.ArgumentParser) -> None:
    """What only a series of many pairs has."""
    parser.add_argument(
        "--dt-us", type=_positive, metavar="US", help="time between the frames, if the run does not know"
    )
    parser.add_argument("--workers", type=_count, metavar="N", help="processes (default: one a core)")


def _sigma_limit_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--sigma-limit",
        dest="sigma_limit_px",
        type=_positive,
        metavar="PX",
        help="leave out what the fitted map knows less well than this",
    )


def _route_option(parser: argparse.ArgumentParser, default: str) -> None:
    parser.add_argument(
        "--route",
        choices=("image", "compare", "best"),
        default=default,
        help="correct the frames; also trace raw vectors and compare; or the better one in each region",
    )


def _bench_verbs(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Verbs that use a bench: what moves, what sees, and runs of both."""
    acquire = verbs.add_parser("acquire", help="carry a plan out on a bench, correcting frames as they arrive")
    acquire.add_argument("plan", type=Path, metavar="PLAN", help="plan.yaml")
    _bench_options(acquire)
    acquire.add_argument("-o", "--out", type=Path, default=Path("runs"), help="folder of runs (default: runs)")
    acquire.add_argument("--dry-run", action="store_true", help="print what it would do, open nothing")
    acquire.add_argument("--home", action="store_true", help="home every axis first, in the configured order")
    acquire.add_argument("--no-correct", dest="correct", action="store_false", help="raw frames only")
    acquire.add_argument("--scene", type=Path, help="scene for the correction, such as a fitted one")
    acquire.add_argument("--target-clear", type=Path, metavar="T", help="bare target, for the dewarp")
    acquire.add_argument("--dewarp-order", type=int, choices=(2, 3, 4, 5), default=2, help="its order")
    acquire.add_argument("--method", choices=("quintic", "bilinear"), default="quintic", help="interpolation")
    acquire.add_argument(
        "--live-queue", type=_count, default=4, metavar="N", help="frames that may wait (default 4)"
    )

    operator = "who answers for the light of a flow on a simulated bench; at a real laser its word is typed"
    acquire.add_argument("--operator", metavar="NAME", help=operator)
    resume = verbs.add_parser("resume", help="go on with a run that was interrupted")
    resume.add_argument("run", type=Path, metavar="RUN", help="folder of the run")
    resume.add_argument("--home", action="store_true", help="home every axis first, in the configured order")
    resume.add_argument("--operator", metavar="NAME", help=operator)

    resume.add_argument(
        "--retake", action="store_true", help="take steps again of which a frame is missing or damaged"
    )

    for verb in (acquire, resume):
        verb.add_argument("--live", action="store_true", help="show frames on a page in the browser as they come")

    check = verbs.add_parser("check", help="whether files are right, and runs what was acquired")
    check.add_argument(
        "paths", type=Path, nargs="+", metavar="PATH", help="scene, bench, plan or PIV file, or folder of a run"
    )
    check.add_argument(
        "--bench", type=Path, help="bench on which plans are tried (default: bench.yaml beside them)"
    )

    stage = verbs.add_parser("stage", help="where the axes are; home, move or jog them, or a prompt that does")
    actions = ("session", "where", "home", "move", "jog")
    stage.add_argument("action", nargs="?", choices=actions, default="session", help="default: a prompt (session)")
    stage.add_argument("axes", nargs="*", metavar="AXIS[=MM]", help="move: axis=mm; jog: axis=+-mm; home: axis")
    stage.add_argument("--home", action="store_true", help="home every axis first, in the configured order")
    _bench_options(stage)

    laser = verbs.add_parser(
        "laser", help="switch a laser off from anywhere, look at it, or align with weak pulses"
    )
    laser.add_argument(
        "action", nargs="?", choices=("off", "state", "align"), default="state", help="default: state"
    )
    laser.add_argument("--name", help="which device of kind timing, if the bench has several")
    laser.add_argument("--rate-hz", type=_positive, default=5.0, help="of align (default 5)")
    laser.add_argument("--for-s", type=_positive, default=5.0, help="of align (default 5)")
    _bench_options(laser)

    camera = verbs.add_parser("camera", help="list cameras, or take a frame")
    camera.add_argument("action", choices=("list", "snap"))
    _bench_options(camera)
    camera.add_argument("-o", "--out", type=Path, default=Path("snap.tif"), help="file (default: snap.tif)")

    live = verbs.add_parser("live", help="a page in the browser with frames as they come; nothing is kept")
    _bench_options(live)
    live.add_argument("--scene", type=Path, help="scene for the correction, such as a fitted one")
    live.add_argument("--no-correct", dest="correct", action="store_false", help="raw frames only")
    live.add_argument("--port", type=_count, default=0, metavar="N", help="of the page (default: a free one)")
    live.add_argument(
        "--shows", choices=("chessboard", "particles", "flow"), default="chessboard", help="what is to be seen"
    )
    live.add_argument("--for-s", type=_positive, help="end by itself after this time")

    doctor = verbs.add_parser("doctor", help="what this computer has, and what a bench still lacks")
    doctor.add_argument("--bench", type=Path, help="bench.yaml to check as well")

    emulate = verbs.add_parser("emulate", help="the simulated bench for other programs, until Ctrl-C")
    emulate.add_argument("bench", type=Path, metavar="BENCH", help="bench.yaml with a simulation section")
    emulate.add_argument(
        "--shows", choices=("chessboard", "particles", "flow"), default="chessboard", help="what is seen"
    )
    emulate.add_argument("--for-s", type=_positive, help="end by itself after this time")


def _bench_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--bench", type=Path, default=Path("bench.yaml"), help="bench file (default: bench.yaml)")
    parser.add_argument("--simulate", action="store_true", help="its simulation in place of the hardware")


def _finite(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"should be a number, not {text!r}")
    return value


def _positive(text: str) -> float:
    if (value := _finite(text)) <= 0.0:
        raise argparse.ArgumentTypeError(f"should be above 0, not {text}")
    return value


def _steps(text: str) -> tuple[str, ...]:
    return () if text == "none" else tuple(word.strip() for word in text.split(","))


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"should be 1, 2, 3 ..., not {text!r}")
    return int(text)
