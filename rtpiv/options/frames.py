"""Verbs that look at frames and runs that are there, and at scenes; no device is touched."""

import argparse
from pathlib import Path

from rtpiv.options.numbers import count, finite, length, positive, steps


def frames(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add them."""
    compare = verbs.add_parser("compare", help="what arrangements of your lenses and balls would show, beforehand")
    lists = (
        ("--lenses-mm", positive, None, "focal lengths"),
        ("--distances-mm", positive, None, "from the lens to the plane"),
        ("--balls-mm", positive, None, "diameters of balls"),
        ("--counts", count, (1, 2, 3), "numbers of balls (default: 1 2 3)"),
        ("--arrangements", str, ("row",), "row, side, triangle, pyramid (default: row)"),
        ("--glasses", str, ("BK7",), "acrylic, borosilicate, BK7 ..., or an index (default: BK7)"),
        ("--gaps-mm", length, (0.0,), "from the plane to the lowest ball (default: 0)"),
    )
    for name, read, usual, text in lists:
        compare.add_argument(
            name, type=read, nargs="+", metavar="A", help=text, required=usual is None, default=usual
        )
    compare.add_argument(
        "--sensor-px", type=count, nargs=2, default=(2016, 2016), metavar=("W", "H"), help="frames of the camera"
    )
    compare.add_argument("--pixel-pitch-um", type=positive, default=11.0, help="size of a pixel (default 11)")
    compare.add_argument("--f-number", type=positive, default=22.0, help="of the lens (default 22)")
    compare.add_argument(
        "--error-px", type=positive, default=0.1, help="error of a displacement that is of use (default 0.1)"
    )
    compare.add_argument("--wavelength-nm", type=positive, default=532.0, help="of the light (default 532)")
    compare.add_argument("-o", "--out", type=Path, help="folder (default: compare, or compare-2 ...)")

    trace = verbs.add_parser("trace", help="what a scene shows: recovered field of view, folds, pictures")
    trace.add_argument("scene", type=Path, metavar="SCENE", help="scene.yaml")
    trace.add_argument("-o", "--out", type=Path, help="folder for pictures (default: trace, or trace-2 ...)")

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
        "-o", "--out", type=Path, help="folder for scene and report (default: fit, or fit-2 ...)"
    )
    calibrate.add_argument("--square-mm", type=positive, help="square of the board; a run knows it (default 2.5)")
    calibrate.add_argument("--disc-mm", type=positive, help="its discs; a run knows it (default 0.4 of a square)")

    correct = verbs.add_parser("correct", help="frames as if the glass were not there")
    correct.add_argument(
        "frames",
        type=Path,
        nargs="+",
        metavar="FRAME",
        help="acquired frames (.tif, .png, .bmp; page 2 of a stack: stack.tif@2)",
    )
    correct.add_argument("--scene", type=Path, required=True, help="scene.yaml")
    correct.add_argument("-o", "--out", type=Path, help="folder (default: corrected, or corrected-2 ...)")
    correct.add_argument("--target-clear", type=Path, metavar="T", help="bare target, for the dewarp")
    correct.add_argument("--dewarp-order", type=int, choices=(2, 3, 4, 5), default=2, help="its order")
    correct.add_argument("--square-mm", type=positive, help="square of the board; a run knows it (default 2.5)")
    correct.add_argument("--disc-mm", type=positive, help="its discs; a run knows it (default 0.4 of a square)")
    correct.add_argument("--method", choices=("quintic", "bilinear"), default="quintic", help="interpolation")
    correct.add_argument("--blend", type=count, default=1, metavar="K", help="join the K best views of a node")
    correct.add_argument("--float", dest="as_float", action="store_true", help="write float32, not offset uint16")
    _sigma_limit_option(correct)
    correct.add_argument("--check-target", action="store_true", help="frames show the target: report its errors")

    evaluate = verbs.add_parser("evaluate", help="vectors of a pair seen through glass, with a report")
    evaluate.add_argument(
        "paths", type=Path, nargs="+", metavar="PATH",
        help="frame A and frame B, or one run, or B%%05d_a.tif, stack.tif, data.h5",
    )  # fmt: skip
    evaluate.add_argument("--scene", type=Path, help="scene.yaml, best a fitted one (default: the run's own)")
    evaluate.add_argument("-o", "--out", type=Path, help="folder (default: evaluation, or evaluation-2 ...)")
    evaluate.add_argument("--target-clear", type=Path, metavar="T", help="bare target, for the dewarp")
    evaluate.add_argument("--dewarp-order", type=int, choices=(2, 3, 4, 5), default=2, help="its order")
    evaluate.add_argument("--square-mm", type=positive, help="square of the board; a run knows it (default 2.5)")
    evaluate.add_argument("--disc-mm", type=positive, help="its discs; a run knows it (default 0.4 of a square)")
    evaluate.add_argument("--shift-mm", type=finite, nargs=2, metavar=("X", "Y"), help="true shift, y up")
    evaluate.add_argument(
        "--stage-sigma-um", type=positive, default=10.0, help="standard error of the stage (default 10)"
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
    sheet.add_argument(
        "paths",
        type=Path,
        nargs="+",
        metavar="PATH",
        help="flow run, frames in pairs (folder, pattern, stack), or A, B, A, B ...",
    )
    sheet.add_argument("--scene", type=Path, required=True, help="scene.yaml, fitted")
    sheet.add_argument("-o", "--out", type=Path, help="folder (default: sheet, or sheet-2 ...)")

    join = verbs.add_parser("join", help="one mean of two runs of a flow, focused beside the glass and behind it")
    join.add_argument("beside", type=Path, metavar="SERIES_BESIDE", help="series of the run focused on the plane")
    join.add_argument(
        "behind", type=Path, metavar="SERIES_BEHIND", help="series of the run focused behind the glass"
    )
    join.add_argument("-o", "--out", type=Path, help="folder (default: joined, or joined-2 ...)")

    mean = verbs.add_parser("mean", help="mean flow, Reynolds stresses and their uncertainty from many pairs")
    mean.add_argument(
        "path",
        type=Path,
        metavar="RUN_OR_SERIES",
        help="flow run, frames in pairs (folder, pattern, stack), or a series",
    )
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

    campaign = verbs.add_parser(
        "campaign", help="many runs: chunks on all cores, here or on a cluster, and one mean"
    )
    campaign.add_argument("action", choices=("plan", "run", "status", "merge"), help="one after the other")
    campaign.add_argument("runs", type=Path, nargs="*", metavar="RUN", help="of plan, and of the first run")
    campaign.add_argument(
        "-o", "--out", type=Path, default=Path("campaign"), help="folder of the campaign (default: campaign)"
    )
    asked = campaign.add_argument_group("plan", "where runs are named")
    asked.add_argument(
        "--scene", dest="scenes", type=Path, nargs="+", default=(), metavar="S",
        help="one for all runs, or one for each in their order (default: each run's own)",
    )  # fmt: skip
    asked.add_argument("--chunk", type=count, metavar="N", help="pairs a chunk, a power of two (default 128)")
    asked.add_argument("--target-clear", type=Path, metavar="T", help="bare target, for the dewarp")
    asked.add_argument("--dewarp-order", type=int, choices=(2, 3, 4, 5), help="its order (default 2)")
    asked.add_argument(
        "--dt-us", type=positive, metavar="US", help="time between the frames, if the runs do not know"
    )
    _sigma_limit_option(asked)
    _piv_options(campaign)
    by = campaign.add_argument_group("run", "who does the work; by default all cores of this computer")
    by.add_argument("--workers", type=count, metavar="N", help="processes (default: one a core)")
    by.add_argument("--scheduler", metavar="TCP", help="Dask workers of this scheduler, tcp://HOST:8786")
    by.add_argument("--slurm", type=count, metavar="N", help="Slurm jobs, N at a time")
    by.add_argument(
        "--slurm-set", dest="slurm_options", nargs="+", default=(), metavar="NAME=VALUE",
        help="options of submitit, such as slurm_partition=long timeout_min=600 mem_gb=8",
    )  # fmt: skip
    by.add_argument("--slurm-here", action="store_true", help="this computer in place of Slurm, to try it")
    by.add_argument(
        "--patience-s", type=positive, default=300.0, metavar="S",
        help="after which a worker that finishes no pair is given up (default 300)",
    )  # fmt: skip

    report = verbs.add_parser("report", help="a run as one page: pictures, vectors, errors, books, provenance")
    report.add_argument("run", type=Path, metavar="RUN", help="folder of the run")
    report.add_argument("--scene", type=Path, help="scene.yaml, best a fitted one (default: the run's own)")
    report.add_argument("-o", "--out", type=Path, help="folder for the page (default: RUN/report)")
    report.add_argument("--target-clear", type=Path, metavar="T", help="bare target, for the dewarp")
    report.add_argument("--dewarp-order", type=int, choices=(2, 3, 4, 5), default=2, help="its order")
    report.add_argument(
        "--stage-sigma-um", type=positive, default=10.0, help="standard error of the stage (default 10)"
    )
    _route_option(report, "compare")
    _piv_options(report)

    export = verbs.add_parser(
        "export", help="vectors for MATLAB, ParaView or Tecplot; maps of a scene as NetCDF or TIFF"
    )
    export.add_argument(
        "files", type=Path, nargs="+", metavar="FILE", help="vectors.nc, mean.nc, chunks of a series; scene.yaml"
    )
    export.add_argument(
        "--to", choices=("matlab", "paraview", "tecplot", "netcdf", "tiff"), required=True, help="for whom"
    )
    export.add_argument("-o", "--out", type=Path, help="folder (default: exported, or exported-2 ...)")


def _piv_options(parser: argparse.ArgumentParser) -> None:
    """How pairs are correlated; each wins over the file."""
    piv = parser.add_argument_group("correlation", "docs/files.md says more; the page shows what they trade")
    piv.add_argument("--piv", type=Path, metavar="FILE", help="YAML file with all settings")
    piv.add_argument("--first-window", type=count, metavar="PX", help="side of the first windows (default 64)")
    piv.add_argument("--final-window", type=count, metavar="PX", help="side of the last windows (default 32)")
    piv.add_argument("--passes", type=count, metavar="N", help="passes (default 4)")
    piv.add_argument("--overlap", type=finite, metavar="SHARE", help="of neighbouring windows (default 0.5)")
    piv.add_argument("--window", choices=("gaussian", "square"), help="weights of the windows (default gaussian)")
    piv.add_argument(
        "--prepare",
        type=steps,
        metavar="STEPS",
        help="what is done to frames, such as sliding-minimum,min-max (the default of a flow run is "
        "sliding-minimum), or none",
    )
    piv.add_argument("--denoise", type=finite, metavar="BETA", help="0 keeps all detail (default 2)")


def _series_options(parser: argparse.ArgumentParser) -> None:
    """What only a series of many pairs has."""
    parser.add_argument(
        "--dt-us", type=positive, metavar="US", help="time between the frames, if the run does not know"
    )
    parser.add_argument("--workers", type=count, metavar="N", help="processes (default: one a core)")


def _sigma_limit_option(parser: "argparse._ActionsContainer") -> None:
    parser.add_argument(
        "--sigma-limit",
        dest="sigma_limit_px",
        type=positive,
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
