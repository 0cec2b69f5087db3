"""The camera's process: how it is started, its first lines, and the messages between it and us.

It is an ordinary child (`daq.child`) that inherits one end of a socket pair.  multiprocessing would import the
caller's script once more in the child, so every script needed the guard ``if __name__ == "__main__"``; here the
child never sees the script.

The child ends by itself when its parent's end of the pair is closed, whatever ended the parent.

A message is one JSON object, over a pipe.  Requests carry a number and are answered under the same number, so an
answer that comes late is never taken for the next one.  Errors travel as the name of a class of daq.errors and a
sentence.
"""

import json
import os
import signal
import subprocess
import sys
from multiprocessing import Pipe
from multiprocessing import connection as connections
from multiprocessing.connection import Connection
from typing import Any

import daq.errors as errors
from daq.child import child
from daq.errors import CameraSetupError

Message = dict[str, Any]


def send(pipe: "Connection[Any, Any]", message: Message) -> None:
    """Send one message."""
    pipe.send_bytes(json.dumps(message).encode())


def receive(pipe: "Connection[Any, Any]") -> Message:
    """Receive one message; EOFError or OSError if the other side is gone."""
    message = json.loads(pipe.recv_bytes())
    if not isinstance(message, dict):
        raise OSError("a message is not an object")
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


Pair = tuple["subprocess.Popen[bytes]", "connections.Connection[Any, Any]"]


def start(cti: str, serial: str | None) -> Pair:
    """Start the process for a producer's file; return it, and our end of the channel.

    Raises
    ------
    CameraSetupError
        The process cannot be started; the message says why.
    """
    ours, theirs = Pipe()
    handle = theirs.fileno()
    command, environment = child(__name__, str(handle), cti, *([] if serial is None else [serial]))
    options: dict[str, Any] = {"pass_fds": [handle]}
    if sys.platform == "win32":
        os.set_handle_inheritable(handle, True)
        options = {"startupinfo": subprocess.STARTUPINFO(lpAttributeList={"handle_list": [handle]})}
    try:
        return subprocess.Popen(command, stdin=subprocess.DEVNULL, env=environment, **options), ours
    except OSError as error:
        ours.close()
        raise CameraSetupError(f"{sys.executable} cannot be started for the camera: {error.strerror}") from error
    finally:
        theirs.close()


def main() -> None:
    """Serve as the child; only here the camera's libraries are imported."""
    for name in ("SIGINT", "SIGHUP"):  # Ctrl-C and a closed window reach both processes; the parent decides
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    handle = int(sys.argv[1])
    pipe: Any
    if sys.platform == "win32":
        pipe = connections.PipeConnection(handle)
    else:
        pipe = connections.Connection(handle)
    cti, serial = sys.argv[2], sys.argv[3] if len(sys.argv) > 3 else None
    try:
        from daq.cameras.harvesters_worker import serve
    except ImportError as error:
        receive(pipe)
        text = f"{error}; install the extra rtpiv[camera] (harvesters, genicam)"
        send(pipe, {"answer": 1, "error": CameraSetupError.__name__, "text": text})
        return
    serve(pipe, cti, serial)


if __name__ == "__main__":
    main()
