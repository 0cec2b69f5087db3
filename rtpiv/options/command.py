"""The whole command line."""

import argparse

from rtpiv.options.bench import bench
from rtpiv.options.first_hour import first_hour
from rtpiv.options.frames import frames
from rtpiv.options.numbers import count

PICTURES = {  # what a verb draws when all else is written and said
    "trace": "the pictures",
    "compare": "the picture",
    "calibrate": "the pictures",
    "correct": "the overview",
    "evaluate": "the page",
}


TRUST = "programs named by the bench file that may be called, as package.module:name, with commas between"


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
    words.add_argument("--threads", type=count, metavar="N", help="cores to use (default: all)")
    words.add_argument("--trust", metavar="NAMES", help=TRUST)
    verbs = words.add_subparsers(dest="verb", metavar="VERB")
    first_hour(verbs)
    frames(verbs)
    bench(verbs)
    for name, left_out in PICTURES.items():
        verbs.choices[name].add_argument(
            "--no-pictures", dest="pictures", action="store_false", help=f"leave out {left_out}"
        )
    for verb in verbs.choices.values():  # before the verb or behind it
        verb.add_argument(
            "--threads", type=count, metavar="N", default=argparse.SUPPRESS, help="cores to use (default: all)"
        )
        verb.add_argument("--trust", metavar="NAMES", default=argparse.SUPPRESS, help=TRUST)
    return words
