"""Verbs of the first hour."""

import argparse
from pathlib import Path

from rtpiv.options.numbers import count, finite, positive


def first_hour(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add verbs that need no lab."""
    init = verbs.add_parser("init", help="write scene, bench and plan files for a lab; asks, or takes options")
    init.add_argument(
        "folder", type=Path, nargs="?", default=Path(), metavar="FOLDER", help="where (default: here)"
    )
    init.add_argument("--yes", dest="ask", action="store_false", help="ask nothing, take what is usual")
    init.add_argument("--overwrite", action="store_true", help="replace files that are there")
    init.add_argument("--name", help="of the bench: letters, digits, underscores (default lab)")
    init.add_argument("--sensor-px", type=count, nargs=2, metavar=("W", "H"), help="frames of the camera")
    init.add_argument("--pixel-pitch-um", type=positive, metavar="UM", help="size of a pixel (default 4.8)")
    init.add_argument(
        "--lens-mm", type=positive, metavar="MM", help="focal length (default: the longest that sees all balls)"
    )
    init.add_argument(
        "--distance-mm", type=positive, metavar="MM", help="from the lens to the plane (default 500)"
    )
    init.add_argument("--balls", type=count, metavar="N", help="how many (default 2)")
    init.add_argument(
        "--arrangement", choices=("row", "side", "triangle", "pyramid", "sc", "bcc", "hcp"),
        help="one behind the other, beside each other, ...; sc, bcc, hcp: packed beds"
        " (default: row; triangle of 3, pyramid of 4 or 5)",
    )  # fmt: skip
    init.add_argument(
        "--ball-mm", type=positive, nargs="+", metavar="MM",
        help="diameter of a ball, or of each in a row or side (default 40)",
    )  # fmt: skip
    init.add_argument(
        "--glass", nargs="+", metavar="NAME",
        help="of the balls, or of each in a row or side: acrylic, BK7, borosilicate ... (default acrylic)",
    )  # fmt: skip
    init.add_argument(
        "--turn-deg", type=finite, metavar="DEG", help="by which the camera looks from the side (default 0)"
    )
    init.add_argument(
        "--gap-mm",
        type=finite,
        metavar="MM",
        help="from the plane to the lowest ball (default: where they show most)",
    )
    init.add_argument(
        "--support-mm", type=finite, metavar="MM", help="diameter of steel rods that hold them (default 0)"
    )
    init.add_argument("--wavelength-nm", type=positive, metavar="NM", help="of the light (default 532)")

    examples = verbs.add_parser("examples", help="copy the example scenes, benches and plans into a folder")
    examples.add_argument("out", type=Path, nargs="?", default=Path("examples"), metavar="FOLDER", help="where to")

    schema = verbs.add_parser("schema", help="JSON schemas of the three files, for editors")
    schema.add_argument("-o", "--out", type=Path, default=Path("schemas"), help="folder (default: schemas)")

    verbs.add_parser("warm", help="compile now what first commands would wait for: for images and clusters")

    completion = verbs.add_parser("completion", help="completion of verbs and options for a shell")
    completion.add_argument("shell", choices=("bash", "zsh", "fish"))

    benchmark = verbs.add_parser("benchmark", help="run time against error on this machine, for one scene")
    benchmark.add_argument("scene", type=Path, metavar="SCENE", help="scene.yaml")
    benchmark.add_argument("-o", "--out", type=Path, default=Path("benchmark"), help="folder for its files")
    benchmark.add_argument("--rounds", type=count, default=9, help="interleaved rounds (default 9)")

    demo = verbs.add_parser("demo", help="see through simulated glass, from frames to pictures")
    demo.add_argument("-o", "--out", type=Path, default=Path("demo"), help="folder for everything (default: demo)")
