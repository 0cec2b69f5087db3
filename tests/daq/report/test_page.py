"""The page: self-contained, escaped, and shown by a real browser without a word on its console."""

import re
import shutil
import subprocess

import numpy as np
import pytest

from daq.report import Page, grey, tinted


def page():
    made = Page("run <script>alert(1)</script> & more")
    picture = grey(np.arange(4800).reshape(60, 80), (0.0, 4800.0))
    made.heading("Pictures")
    made.slider(picture, 255 - picture, ("raw", "corrected"), "drag <me>")
    made.picture(tinted(picture, picture > 40), "mask")
    made.svg(b'<svg xmlns="http://www.w3.org/2000/svg" width="10" height="10"/>', "figure")
    made.table(("name", "value"), [("a<b", "1")])
    made.text("plain & simple")
    return made


def test_nothing_is_fetched_and_everything_is_escaped():
    text = page().html()
    assert "<script" not in text
    assert "a&lt;b" in text
    assert "drag &lt;me&gt;" in text
    assert not re.findall(r"""(?:src|href)\s*=\s*["'](?!data:)""", text)
    assert "url(" not in text
    assert "viewport" in text


def test_pages_are_written_whole_or_not_at_all(tmp_path, mocker):
    page().write(tmp_path / "report.html")
    assert (tmp_path / "report.html").read_text().endswith("</html>\n")
    mocker.patch("os.fsync", side_effect=OSError(28, "No space left on device"))
    with pytest.raises(OSError, match="No space"):
        page().write(tmp_path / "other.html")
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


@pytest.mark.parametrize("width", [390, 1400])
def test_a_browser_shows_it(tmp_path, width):
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no headless browser (chromium) on this machine")
    path = tmp_path / "report.html"
    page().write(path)
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"]
    flags += [
        "--disable-quic",
        "--disable-component-update",
        "--disable-sync",
        f"--user-data-dir={tmp_path / 'user'}",
    ]
    shot = tmp_path / "shot.png"
    subprocess.run(
        [browser, *flags, f"--window-size={width},900", f"--screenshot={shot}", path.as_uri()],
        check=True,
        capture_output=True,
        timeout=120,
    )
    dom = subprocess.run(
        [browser, *flags, "--dump-dom", path.as_uri()], check=True, capture_output=True, timeout=120, text=True
    ).stdout
    assert shot.stat().st_size > 3000
    assert dom.count("<figure>") == 3
    assert 'type="range"' in dom
