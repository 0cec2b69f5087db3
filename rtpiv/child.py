"""A module of ours as a program of its own: ``python -P -m rtpiv.child MODULE WORDS...``, as ``python -m MODULE``.

It differs from that in one thing: a user's sim.py or daq.py hides nothing (see `rtpiv.neighbours`).
"""

import runpy
import sys

if __name__ == "__main__":
    del sys.argv[0]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
