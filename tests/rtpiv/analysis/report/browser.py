"""A real browser without a window; tests that need one skip by name where there is none."""

import html
import json
import re
import shutil
import subprocess

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--host-resolver-rules=MAP * ~NOTFOUND",  # nothing outside is ever asked
)


def browse(page, folder, *arguments):
    """Open a page; return what the browser says on standard output."""
    browser = next((found for found in map(shutil.which, NAMES) if found), None)
    if browser is None:
        pytest.skip("no headless browser (chromium) on this machine")
    command = [browser, *FLAGS, f"--user-data-dir={folder / 'user'}", *arguments, page.as_uri()]
    return subprocess.run(command, check=True, capture_output=True, timeout=120, text=True).stdout


MEASURE = """<script>
addEventListener("load", () => {
  const loaded = [...document.images].every(image => image.complete && image.naturalWidth > 0);
  const needed = document.documentElement.scrollWidth, inside = innerWidth;
  const slider = document.querySelector(".stage input");
  slider.value = 20;
  slider.oninput();
  const clip = getComputedStyle(document.querySelectorAll(".layer")[1]).clipPath;
  document.querySelectorAll(".choice input")[1].click();
  const mask = getComputedStyle(document.querySelectorAll(".layer")[2]).display;
  parent.document.title = JSON.stringify({needed, inside, loaded, clip, mask});
});
</script>"""


def measured(page, folder, width):
    """What a page with a slider is like `width` px wide: in a frame, because no window is as narrow as a phone."""
    inner = html.escape(page.replace("</body>", MEASURE + "</body>"))
    path = folder / "frame.html"
    path.write_text(f'<title></title><iframe width="{width}" height="800" srcdoc="{inner}"></iframe>')
    dom = browse(path, folder, "--window-size=1600,900", "--virtual-time-budget=4000", "--dump-dom")
    found = re.search(r"<title>(\{.*?\})</title>", dom)
    assert found, dom[:300]
    return json.loads(html.unescape(found[1]))
