"""A real browser without a window; tests that need one skip by name where there is none."""

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
