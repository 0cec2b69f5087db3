"""A page of this computer for a verb: served until Ctrl-C."""

from collections.abc import Callable
from contextlib import suppress
from importlib.util import find_spec
from typing import TYPE_CHECKING

from daq.errors import RunUsageError
from ground.terminal import console

if TYPE_CHECKING:
    from daq.live.local_page import PageServer


def require_live() -> None:
    """Raise RunUsageError if the extra that pages need is not installed."""
    if find_spec("websockets") is None:
        raise RunUsageError("the page needs an extra: pip install 'rtpiv[live]'")


def serve_page(make_page: Callable[[], "PageServer"]) -> None:
    """Serve a page until Ctrl-C; RunUsageError if its port is taken."""
    try:
        page = make_page()
    except OSError as error:
        raise RunUsageError(
            f"the page cannot be shown: {error.strerror or error}; choose another --port"
        ) from None
    screen = console()
    screen.print(f"look at {page.access.url}", soft_wrap=True, highlight=False)
    screen.print("from elsewhere: ssh -L the port to this computer; Ctrl-C ends it")
    try:
        with suppress(KeyboardInterrupt):
            page.serve()
    finally:
        page.close()
