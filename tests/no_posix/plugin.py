"""The fast tests as on a system without POSIX: ``make test-without-posix``.

Hidden from our packages, here and in programs that tests start, is what `lacking` lists. A test whose subject
needs one of those modules (a pseudo-terminal, a GenTL producer) is skipped and says which; one that fails for
another reason fails.
"""

import os
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

from tests.no_posix import lacking

lacking.hide()
FOLDERS = (str(Path(__file__).parent), str(Path(__file__).parents[2]))
os.environ["PYTHONPATH"] = os.pathsep.join((*FOLDERS, *filter(None, [os.environ.get("PYTHONPATH")])))
LACKS = (*(f"No module named '{name}'" for name in lacking.MODULES), "'socket' has no attribute 'AF_UNIX'")


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Generator[None, Any, Any]:
    """The same of a file whose tests all need one."""
    report = yield
    if report.failed and (lacks := lacking_in(report)):
        report.outcome = "skipped"
        report.longrepr = (report.fspath, 0, lacks)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, Any, Any]:
    """Skip, by name of the module, what truly needs one."""
    report = yield
    if report.failed and (lacks := lacking_in(report)):
        report.outcome = "skipped"
        report.longrepr = (str(item.path), item.location[1] or 0, lacks)
    return report


def lacking_in(report: Any) -> str | None:
    """What a failure says that the system lacks."""
    lacks = next((words for words in LACKS if words in report.longreprtext), None)
    return f"Linux: {lacks}" if lacks else None
