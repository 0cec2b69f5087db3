"""A real browser without a screen, spoken to by its own protocol (Chrome DevTools) over loopback."""

import base64
import json
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.request import urlopen

from websockets.sync.client import ClientConnection, connect

NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--no-first-run",
    "--remote-debugging-port=0", "--disable-extensions", "--disable-component-update", "--hide-scrollbars",
)  # fmt: skip


def chromium() -> str | None:
    """The browser of this computer, if it has one."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


class Tab:
    """A page in the browser."""

    def __init__(self, connection: ClientConnection) -> None:
        self._socket, self._count = connection, 0

    def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._count += 1
        self._socket.send(json.dumps({"id": self._count, "method": method, "params": parameters}))
        while True:
            said = json.loads(self._socket.recv(timeout=60.0))
            if said.get("id") == self._count:
                assert "error" not in said, said
                return dict(said["result"])

    def value(self, expression: str) -> Any:
        """What a piece of script says."""
        said = self.ask("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in said, said
        return said["result"].get("value")

    def until(self, expression: str, most_s: float = 30.0) -> None:
        """Wait until an expression is true."""
        end_s = time.monotonic() + most_s
        while not self.value(expression):
            assert time.monotonic() < end_s, expression
            time.sleep(0.02)

    def picture(self, path: Path, width: int, height: int) -> None:
        self.ask(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False
        )
        time.sleep(0.5)
        path.write_bytes(base64.b64decode(self.ask("Page.captureScreenshot", format="png")["data"]))


@contextmanager
def tab_at(url: str) -> Iterator[Tab]:
    """A browser of its own with a page open."""
    program = chromium()
    assert program is not None
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        command = [program, *FLAGS, f"--user-data-dir={folder}", "about:blank"]
        browser = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            port_file = Path(folder) / "DevToolsActivePort"
            end_s = time.monotonic() + 60.0
            while not (port_file.exists() and port_file.read_text().count("\n")):
                assert time.monotonic() < end_s
                time.sleep(0.05)
            port = port_file.read_text().splitlines()[0]
            with urlopen(f"http://127.0.0.1:{port}/json/list", timeout=10.0) as answer:
                pages = [page for page in json.load(answer) if page["type"] == "page"]
            with connect(pages[0]["webSocketDebuggerUrl"], max_size=None, compression=None) as connection:
                tab = Tab(connection)
                tab.ask("Page.navigate", url=url)
                yield tab
        finally:
            browser.terminate()
            browser.wait(20.0)
