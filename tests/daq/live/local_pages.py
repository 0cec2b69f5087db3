"""A local page in a thread, and a browser that speaks to it."""

import json
import threading
from contextlib import contextmanager

from websockets.sync.client import connect


@contextmanager
def served(page):
    server = threading.Thread(target=page.serve, daemon=True)
    server.start()
    try:
        yield page
    finally:
        page.close()
        server.join(5.0)


@contextmanager
def browser_of(page, path, token=None, **options):
    """A socket of our own page that has sent the token, or another one."""
    host, options = f"127.0.0.1:{page.access.port}", {"origin": f"http://127.0.0.1:{page.access.port}"} | options
    with connect(f"ws://{host}{path}", **options) as browser:
        browser.send(json.dumps({"token": page.access.token if token is None else token}))
        yield browser


def say(browser, words):
    browser.send(words if isinstance(words, str | bytes) else json.dumps(words))
    return json.loads(browser.recv(60.0))
