"""One capture process: started by `multiprocessing`, ended without fail, and watched for hanging."""

from __future__ import annotations

import multiprocessing
import pickle
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from pathlib import Path
from threading import Lock
from types import ModuleType
from typing import Any, Final

from ...errors import SourceError
from .child import main
from .protocol import FrameReady, Heartbeat, Opened, Start

#: Time to close the source after the pipe is closed, seconds; then the process is killed.
_CLOSING_S: Final = 1.5
#: Longest wait for a message of the process, seconds.
POLL_S: Final = 0.1
#: Seconds without a heartbeat after which the process counts as hung: while it opens the source, because a driver may
#: hold the interpreter lock; while a camera is stalled or missing; otherwise.
_SILENT_OPENING_S: Final = 20.0
_SILENT_TROUBLE_S: Final = 5.0
_SILENT_S: Final = 1.0
#: Longest call of the source, seconds: opening without progress, the first frame, later frames.
_BUSY_OPENING_S: Final = 120.0
_BUSY_FIRST_FRAME_S: Final = 20.0
_BUSY_S: Final = 1.5
#: A wait of `POLL_S` that takes longer than this is not counted: the machine is too busy, seconds.
_LATE_S: Final = 0.25

_SPAWN: Final = multiprocessing.get_context("spawn")
_spawning = Lock()


class CaptureProcess:
    """One capture process and its pipe; a restart makes another one."""

    def __init__(self, start: Start) -> None:
        try:
            order = pickle.dumps(start)
        except Exception as error:  # objects refuse to be pickled in many ways
            raise SourceError(
                f"the opener of the source cannot be sent to the capture process ({error}); "
                "use a function of a module or functools.partial of one"
            ) from error
        self._connection, theirs = _SPAWN.Pipe()
        self._sending = Lock()
        self._process = _SPAWN.Process(
            target=main, args=(theirs, order, str(Path.cwd())), name="tactune capture", daemon=True
        )
        try:
            with _as_imported_program():
                self._process.start()
        except OSError as error:
            self._connection.close()
            raise SourceError(f"no capture process can be started ({error}); check {sys.executable}") from error
        finally:
            theirs.close()

    @property
    def pid(self) -> int | None:
        """The process's number."""
        return self._process.pid

    @property
    def running(self) -> bool:
        """Whether the process has not ended yet."""
        return self._process.is_alive()

    def receive(self) -> Any:
        """Return the next message, or None after `POLL_S`; `EOFError` or `OSError` if the process has gone."""
        return self._connection.recv() if self._connection.poll(POLL_S) else None

    def send(self, message: Any) -> None:
        """Send a message to the process; one that has gone is noticed by `receive`."""
        with self._sending, suppress(OSError):
            self._connection.send(message)

    def end(self, *, politely: bool) -> str:
        """End the process, by closing its pipe or at once by force; return how it ended, in words."""
        with self._sending:
            self._connection.close()
        if politely:
            self._process.join(_CLOSING_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join(_CLOSING_S)
        status = self._process.exitcode
        if status is None:  # stuck in the kernel
            return "cannot be ended"
        if status >= 0:
            return f"ended with status {status}"
        names = {known.value: known.name for known in signal.Signals}
        return f"was ended by signal {-status} ({names.get(-status, 'unknown')})"


@contextmanager
def _as_imported_program() -> Iterator[None]:
    """Keep `multiprocessing` from running the caller's script again, and Ctrl+C from the start of the process.

    A robot's script then needs no main guard. The new process inherits the blocked signal until it ignores it. A
    daemonic process may start one too: it ends with its pipe.
    """
    own = multiprocessing.current_process()
    has_masks = hasattr(signal, "pthread_sigmask")
    with _spawning:
        if has_masks:
            resource_tracker.ensure_running()  # its start would unblock the signal again
        script, sys.modules["__main__"] = sys.modules["__main__"], ModuleType("__main__")
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if has_masks else set()
        daemonic, own.daemon = own.daemon, False
        try:
            yield
        finally:
            own.daemon = daemonic
            sys.modules["__main__"] = script
            if has_masks:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)


class Patience:
    """Decides when a process hangs.

    Silence is counted in waits without a message, not by the clock: while this process itself was stopped, the
    heartbeats of the other one were queued. Waits that lasted far too long are not counted: the machine was busy.
    """

    def __init__(self) -> None:
        self._silent = 0
        self._busy_s = 0.0
        self._silent_limit_s = _SILENT_OPENING_S
        self._busy_limit_s = _BUSY_OPENING_S

    def heard(self, message: object) -> None:
        """Note a message from the process."""
        self._silent = 0
        if isinstance(message, Opened):
            self._busy_s = 0.0  # the call took long, but it returned
            self._silent_limit_s, self._busy_limit_s = _SILENT_S, _BUSY_FIRST_FRAME_S
        elif isinstance(message, FrameReady):
            self._busy_s = 0.0
            self._busy_limit_s = min(self._busy_limit_s, _BUSY_S)
        elif isinstance(message, Heartbeat):
            self._busy_s = message.busy_s
            if message.health.cameras:  # so the source is open
                well = all(camera.state == "streaming" for camera in message.health.cameras)
                self._silent_limit_s = _SILENT_S if well else _SILENT_TROUBLE_S

    def silent(self, waited_s: float) -> None:
        """Count a wait of `POLL_S` without a message; the argument is its real duration."""
        if waited_s < _LATE_S:
            self._silent += 1

    @property
    def problem(self) -> str:
        """Why the process counts as hung; empty while it does not."""
        silent_s = self._silent * POLL_S
        if silent_s >= self._silent_limit_s:
            return f"has given no sign of life for {silent_s:.0f} s"
        if self._busy_s >= self._busy_limit_s:
            return f"has waited {self._busy_s:.1f} s for its source"
        return ""
