"""``python -m rtpiv`` is the command `rtpiv`."""

import sys

from rtpiv.command import main

sys.exit(main())
