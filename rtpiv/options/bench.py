"""Verbs that use a bench: what moves, what sees, and runs of both."""

import argparse
from pathlib import Path

from rtpiv.options.numbers import count, port, positive


def bench(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add them."""
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
        "--live-queue", type=count, default=4, metavar="N", help="frames that may wait (default 4)"
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

    align = verbs.add_parser("align", help="bring glass and camera to their places by what the camera sees")
    align.add_argument("plan", type=Path, metavar="PLAN", help="plan of experiment: align")
    _bench_options(align)
    align.add_argument("-o", "--out", type=Path, default=Path("runs"), help="folder of runs (default: runs)")
    align.add_argument("--dry-run", action="store_true", help="print the way to the first look, open nothing")
    align.add_argument("--home", action="store_true", help="home every axis first, in the configured order")

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
        "laser", help="switch lasers off from anywhere, look at one, or align with weak pulses"
    )
    laser.add_argument(
        "action", nargs="?", choices=("off", "state", "align"), default="state", help="default: state"
    )
    laser.add_argument("--name", help="which device of kind timing, if there are several (off: all)")
    laser.add_argument("--rate-hz", type=positive, default=5.0, help="of align (default 5)")
    laser.add_argument("--for-s", type=positive, default=5.0, help="of align (default 5)")
    laser.add_argument("--bench", type=Path, help="bench file (default: any here, or above, that names a laser)")
    laser.add_argument("--simulate", action="store_true", help="its simulation in place of the hardware")

    camera = verbs.add_parser("camera", help="list cameras, or take a frame")
    camera.add_argument("action", choices=("list", "snap", "test"))
    _bench_options(camera)
    camera.add_argument("-o", "--out", type=Path, default=Path("snap.tif"), help="file (default: snap.tif)")

    live = verbs.add_parser("live", help="a page in the browser with frames as they come; nothing is kept")
    _bench_options(live)
    live.add_argument("--scene", type=Path, help="scene for the correction, such as a fitted one")
    live.add_argument("--no-correct", dest="correct", action="store_false", help="raw frames only")
    live.add_argument("--port", type=port, default=0, metavar="N", help="of the page (default: a free one)")
    live.add_argument(
        "--shows", choices=("chessboard", "particles", "flow"), default="chessboard", help="what is to be seen"
    )
    live.add_argument("--for-s", type=positive, help="end by itself after this time")

    verbs.add_parser("devices", help="what can be opened from here, and the lines of a bench file that do it")

    doctor = verbs.add_parser("doctor", help="what this computer has, and what a bench still lacks")
    doctor.add_argument("--bench", type=Path, help="bench.yaml to check as well")

    emulate = verbs.add_parser("emulate", help="the simulated bench for other programs, until Ctrl-C")
    emulate.add_argument("bench", type=Path, metavar="BENCH", help="bench.yaml with a simulation section")
    emulate.add_argument(
        "--shows", choices=("chessboard", "particles", "flow"), default="chessboard", help="what is seen"
    )
    emulate.add_argument("--for-s", type=positive, help="end by itself after this time")


def _bench_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--bench", type=Path, default=Path("bench.yaml"), help="bench file (default: bench.yaml)")
    parser.add_argument("--simulate", action="store_true", help="its simulation in place of the hardware")
