"""Starts the capture process and makes sure that it ends.

Neither `multiprocessing` nor a fork: a fresh interpreter that imports nothing but the capture
process works from a script without a main guard, from a notebook and from inside a Qt application.
"""

from __future__ import annotations

import json
import os
import pickle
import signal
import socket
import subprocess
import sys
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Lock
from typing import Any, Final

from ...errors import SourceError
from .protocol import Ring, Start, create_memory

_PROGRAM: Final = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[3]); "
    "from tactune.core.sources.capture.child import main; main(int(sys.argv[1]), int(sys.argv[2]))"
)
#: Time to close the source, then time to end after SIGTERM, seconds; then the process is killed.
_CLOSING_S: Final = 1.5
_ENDING_S: Final = 0.5


class CaptureProcess:
    """One capture process, its socket and its shared memory; a restart makes another one.

    Raises
    ------
    SourceError
        The opener cannot be sent to another process, or no process can be started.
    """

    def __init__(self, start: Start) -> None:
        try:
            order = pickle.dumps(start)
        except Exception as error:  # objects refuse to be pickled in many ways
            raise SourceError(
                f"the opener of the source cannot be sent to the capture process ({error}); "
                "use a function of a module or functools.partial of one"
            ) from error
        ours, theirs = socket.socketpair()
        self._memory = create_memory()
        path = json.dumps([str(entry) or str(Path.cwd()) for entry in sys.path])  # empty: the working folder
        try:
            self._process = subprocess.Popen(  # noqa: S603  # our own program, no shell
                [sys.executable, "-P", "-c", _PROGRAM, str(theirs.fileno()), str(self._memory), path],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,  # what a driver prints must not mix with a command's output
                pass_fds=(theirs.fileno(), self._memory),
                process_group=0,  # only the parent handles Ctrl+C; it then closes its source
            )
        except OSError as error:
            ours.close()
            os.close(self._memory)
            raise SourceError(f"no capture process can be started ({error}); check {sys.executable}") from error
        finally:
            theirs.close()
        self._connection = Connection(ours.detach())
        self._sending = Lock()
        with suppress(OSError):  # a process that has gone already is noticed by `receive`
            self._connection.send_bytes(order)

    @property
    def pid(self) -> int:
        """The process's number."""
        return self._process.pid

    @property
    def running(self) -> bool:
        """Whether the process has not ended yet."""
        return self._process.poll() is None

    def map_ring(self, slots: int, size: int) -> Ring:
        """Map the shared memory, whose size the process has set."""
        return Ring(self._memory, slots, size)

    def receive(self, timeout_s: float) -> Any:
        """Return the next message, or None after ``timeout_s``.

        Raises
        ------
        EOFError, OSError
            The process has gone.
        """
        return self._connection.recv() if self._connection.poll(timeout_s) else None

    def send(self, message: Any) -> None:
        """Send a message to the process.

        Raises
        ------
        OSError
            The process has gone.
        """
        with self._sending:
            self._connection.send(message)

    def end(self, *, politely: bool) -> int | None:
        """End the process and release everything; return its exit status, None if it cannot be ended."""
        with self._sending:
            self._connection.close()
        try:
            return self._wait(politely)
        finally:
            os.close(self._memory)

    def _wait(self, politely: bool) -> int | None:
        """Wait for the process after closing its socket, then after SIGTERM, then after SIGKILL."""
        if politely:
            with suppress(subprocess.TimeoutExpired):
                return self._process.wait(_CLOSING_S)
            self._process.terminate()
            with suppress(subprocess.TimeoutExpired):
                return self._process.wait(_ENDING_S)
        self._process.kill()
        with suppress(subprocess.TimeoutExpired):
            return self._process.wait(_CLOSING_S)
        return None  # stuck in the kernel; the standard library reaps it later


def ending_in_words(status: int | None) -> str:
    """Return how a process with this exit status ended: "was ended by signal 9 (SIGKILL)"."""
    if status is None:
        return "cannot be ended"
    if status < 0:
        try:
            return f"was ended by signal {-status} ({signal.Signals(-status).name})"
        except ValueError:
            return f"was ended by signal {-status}"
    return f"ended with status {status}"
