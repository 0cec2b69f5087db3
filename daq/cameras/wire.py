"""Messages between a camera's process and ours: one JSON object each, over a pipe.

Requests carry a number and are answered under the same number, so an answer that comes late is never taken for
the next one.  Errors travel as the name of a class of daq.errors and a sentence.
"""

import json
from multiprocessing.connection import Connection
from typing import Any

import daq.errors as errors

Message = dict[str, Any]


def send(pipe: "Connection[Any, Any]", message: Message) -> None:
    """Send one message."""
    pipe.send_bytes(json.dumps(message).encode())


def receive(pipe: "Connection[Any, Any]") -> Message:
    """Receive one message; EOFError or OSError if the other side is gone."""
    message = json.loads(pipe.recv_bytes())
    if not isinstance(message, dict):
        raise OSError("a message that is no object")
    return message


def pack_error(error: errors.CameraError) -> Message:
    """An error as a message."""
    return {"error": type(error).__name__, "text": str(error)}


def raise_error(message: Message) -> None:
    """Raise the error that a message carries, if it carries one.

    Raises
    ------
    CameraError
        Or the kind of it that the message names; its text is the message's.
    """
    if "error" not in message:
        return
    kind = getattr(errors, str(message["error"]), None)
    if not (isinstance(kind, type) and issubclass(kind, errors.CameraError)):
        kind = errors.CameraError
    raise kind(str(message.get("text", "")))
