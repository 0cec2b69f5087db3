"""``python -m rtpiv`` is the command `rtpiv`."""

import sys

from rtpiv.command import run

sys.exit(run())
