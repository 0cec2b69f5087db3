"""Somebody who looks at a live page, for `benchmarks.pipeline --viewer`: a browser, or one that draws nothing.

    python -m benchmarks.viewer URL browser     # Chromium without a screen, drawing on this computer's cores
    python -m benchmarks.viewer URL socket      # takes every picture and draws none: a viewer behind an ssh tunnel

Ends when the run says that it is over; then it prints what it saw.
"""

import json
import sys
import time
from typing import Any

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from tests.daq.live.chromium import tab_at

SEEN = {"raw": [0, 0.55], "corrected": [0.45, 1]}
ASKS = {
    "wanted": ["raw", "corrected"],
    "part": [0, 0, 0],
    "room_px": 840,
    "columns": SEEN,
}  # what the page asks for at 1400 px


def by_socket(url: str) -> dict[str, Any]:
    """Take every moment's pictures, say that they are drawn, count."""
    origin, token = url.split("/#")
    begun_s, first_s, last_s = time.monotonic(), 0.0, 0.0
    moments = size = 0
    words: dict[str, Any] = {}
    with connect(f"ws{origin[4:]}/frames", origin=origin, compression=None, max_size=None) as found:
        found.send(json.dumps({"token": token} | ASKS))
        try:
            while not (said := json.loads(found.recv())).get("over"):
                words = said
                size += sum(len(found.recv()) for _ in words["shown"])
                last_s = time.monotonic()
                first_s = first_s or last_s
                moments += 1
                found.send(json.dumps({"drawn": words["number"]} | ASKS))
        except ConnectionClosed:
            pass
    return {
        "first_s": round(first_s - begun_s, 2),
        "moments": moments,
        "moments_a_second": round((moments - 1) / max(last_s - first_s, 1e-9), 1),
        "missed": words.get("missed"),
        "MB_a_second": round(size / 1e6 / max(last_s - first_s, 1e-9), 1),
    }


def by_browser(url: str) -> dict[str, Any]:
    """Let Chromium draw it."""
    state = "(() => ({drawn: rtpivLive.drawn, over: !!rtpivLive.ended, missed: rtpivLive.words.missed}))()"
    last, first_s, last_s = {"drawn": 0, "missed": 0}, 0.0, 0.0
    with tab_at(url) as tab:
        tab.ask("Emulation.setDeviceMetricsOverride", width=1400, height=1000, deviceScaleFactor=1, mobile=False)
        tab.until("window.rtpivLive && rtpivLive.drawn > 0", 120.0)
        first_ms, first_drawn = tab.value("rtpivLive.first_ms"), tab.value("rtpivLive.drawn")
        first_s = time.monotonic()
        while not (said := tab.value(state))["over"]:
            if said["drawn"] != last["drawn"]:
                last, last_s = said, time.monotonic()
            time.sleep(0.5)
    return {
        "first_s": round(first_ms / 1e3, 2),
        "moments": last["drawn"],
        "moments_a_second": round((last["drawn"] - first_drawn) / max(last_s - first_s, 1e-9), 1),
        "missed": last["missed"],
    }


def main() -> None:
    """Look until it is over."""
    url, kind = sys.argv[1:]
    print(json.dumps({"browser": by_browser, "socket": by_socket}[kind](url)))


if __name__ == "__main__":
    main()
