"""A source that is opened in a separate process, which is started again when it dies, hangs or fails."""

from __future__ import annotations

import itertools
import math
import multiprocessing
import pickle
import sys
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from multiprocessing.shared_memory import SharedMemory
from multiprocessing.util import Finalize
from threading import Condition, Event, Lock, Thread, current_thread
from types import ModuleType
from typing import Any, Final

from ...errors import SourceError, TactuneError, closed_on_error
from ...model.frames import SensorFrame
from ..base import CameraOption, CameraRole, FrameSource, Health, Progress
from .child import SLOTS, Call, Ended, FrameReady, Opened, Opener, Opening, Reply, main, read_frame

#: Longest queue of frames; then the oldest frame is dropped.
_MAX_WAITING: Final = SLOTS - 2
#: Longest wait for a message of the process, seconds.
POLL_S: Final = 0.1
#: Seconds without a message after which the process counts as hung: while it opens the source, which may load a driver
#: or simulate; until the first frame; later, since a driver that looks for a lost camera may hold the interpreter lock.
_SILENT_OPENING_S: Final = 60.0
_SILENT_FIRST_S: Final = 20.0
_SILENT_S: Final = 6.0
#: Time to close the source after the pipe is closed, seconds; then the process is killed.
_CLOSING_S: Final = 1.5
#: Seconds that a notice stays in the health message after a restart.
_NOTICE_S: Final = 10.0
_CALL_S: Final = 3.0
#: Pause before a restart, seconds.
_PAUSE_S: Final = 0.3

_SPAWN: Final = multiprocessing.get_context("spawn")
_spawning = Lock()


class ProcessSource(FrameSource):
    """A live source in a separate process.

    Frames come through shared memory, copied once. A capture process that dies, hangs or fails is restarted. Meanwhile
    `health` states the cause and marks the last frame as stale, and `wait` returns False. Sequence numbers keep
    increasing. Frames that are not fetched in time are dropped, the oldest first, and counted in `health`. All
    methods may be called from any thread.

    ``opener`` is called in the capture process with a progress callable. It is pickled, so it must be a function of a
    module (not of the main script or a notebook), or `functools.partial` of one. An exception of ``progress`` cancels
    opening. Errors of opening have the class and message that they have without the process.
    """

    def __init__(self, opener: Opener, progress: Progress | None = None) -> None:
        try:
            order = pickle.dumps(opener)
        except Exception as error:  # objects refuse to be pickled in many ways
            raise SourceError(
                f"the opener of the source cannot be sent to the capture process ({error}); "
                "use a function of a module or functools.partial of one"
            ) from error
        self._supervisor = Supervisor(order)
        # Also called when an unclosed source is collected, and at exit before multiprocessing waits for its processes.
        self._close = Finalize(self, self._supervisor.stop, exitpriority=10)
        with closed_on_error(self._close):
            opened = self._supervisor.wait_until_open(progress)
        self.name, self.rig, self.frame_rate_hz = opened.name, opened.rig, opened.frame_rate_hz

    def next_frame(self) -> SensorFrame | None:
        """Return the next frame, or None at the end; block until there is one. `TactuneError` if it cannot continue."""
        return self._supervisor.next_frame()

    def wait(self, timeout_s: float) -> bool:
        return self._supervisor.wait(timeout_s)

    def health(self) -> Health:
        return self._supervisor.health()

    def options(self) -> tuple[CameraOption, ...]:
        """Return the settings of the cameras; `SourceError` if the capture process does not answer in time."""
        options: tuple[CameraOption, ...] = self._supervisor.call("options")
        return options

    def set_option(self, camera: CameraRole, name: str, value: float) -> None:
        """Change one setting of a camera; it is kept when the capture process is restarted."""
        self._supervisor.call("set_option", camera, name, value)
        self._supervisor.kept_options[camera, name] = value

    def untouched(self) -> SensorFrame | None:
        untouched: SensorFrame | None = self._supervisor.call("untouched")
        return untouched

    def close(self) -> None:
        self._close()


class Supervisor:
    """One thread that runs one capture process at a time; one condition guards all state."""

    def __init__(self, order: bytes) -> None:
        self.kept_options: dict[tuple[CameraRole, str], float] = {}
        self._order = order
        self._changed = Condition()
        self._stop = Event()
        self._serving: _Process | None = None
        self._waiting: deque[tuple[_Process, SharedMemory, FrameReady]] = deque()
        self._opening = Opening(0.0, "")
        self._opened: Opened | None = None
        self._error: TactuneError | None = None
        self._ended = False
        self._numbers = itertools.count()
        self._replies: dict[int, Reply | None] = {}
        # Health: what the present process says, what this one dropped, and what happened to the one before.
        self._health = Health()
        self._dropped = 0
        self._stale = False
        self._notice, self._notice_until_s = "", 0.0
        # Frame numbers go on where another process starts over.
        self._last: tuple[_Process, int] | None = None
        self._shift = 0
        self._thread = Thread(target=self._supervise, name="capture supervisor", daemon=True)
        self._thread.start()

    # From any thread

    def wait_until_open(self, progress: Progress | None) -> Opened:
        """Wait for the opened source and pass on its progress; an exception of ``progress`` ends the wait."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._opened is not None or self._finished, POLL_S)
                opened, error, opening = self._opened, self._error, self._opening
            if opened is not None:
                return opened
            if error is not None:
                raise type(error)(str(error))
            if progress is not None:
                progress(opening.fraction, opening.text)

    def wait(self, timeout_s: float | None) -> bool:
        with self._changed:
            return self._changed.wait_for(lambda: bool(self._waiting) or self._finished, timeout_s)

    def next_frame(self) -> SensorFrame | None:
        """Wait for a frame and return the oldest one; None at the end."""
        with self._changed:
            self.wait(None)
            if not self._waiting:
                if self._error is not None:
                    raise type(self._error)(str(self._error))
                return None
            process, memory, ready = self._waiting.popleft()
        frame = read_frame(memory, ready)
        process.send(ready.slot)
        with self._changed:
            if self._last is not None and self._last[0] is not process:
                self._shift = self._last[1] + 1 - frame.sequence
            frame = replace(frame, sequence=frame.sequence + self._shift)
            self._last = process, frame.sequence
        return frame

    def health(self) -> Health:
        with self._changed:
            now, stale = self._health, self._stale or self._error is not None
            notice = str(self._error or (self._notice if time.monotonic() < self._notice_until_s else ""))
            return replace(
                now,
                ok=now.ok and not stale,
                message=" ".join(filter(None, (notice, now.message))),
                dropped=self._dropped + now.dropped,
                stale=now.stale or stale,
            )

    def call(self, method: str, *arguments: Any) -> Any:
        """Call a method of the source and return what it returns; `TactuneError` if the process does not answer."""
        number = next(self._numbers)
        with self._changed:
            process = self._serving
            self._replies[number] = None
        try:
            if process is None:
                raise SourceError(f"{self._name}: the capture process is not running at present; try again")
            process.send(Call(number, method, arguments))
            with self._changed:
                self._changed.wait_for(lambda: self._replies[number] is not None or self._finished, _CALL_S)
                reply = self._replies[number]
        finally:
            with self._changed:
                del self._replies[number]
        if reply is None:
            raise SourceError(f"{self._name}: the capture process has not answered for {_CALL_S:g} s; try again")
        if reply.error is not None:
            raise type(reply.error)(str(reply.error))  # a raised reply would keep itself and the shared memory
        return reply.value

    def stop(self) -> None:
        self._stop.set()
        if self._thread is not current_thread():  # a forgotten source may be collected in any thread
            self._thread.join()

    @property
    def _finished(self) -> bool:
        return self._ended or self._error is not None

    @property
    def _name(self) -> str:
        return self._opened.name if self._opened is not None else "capture"

    # The thread

    def _supervise(self) -> None:
        try:
            while not (self._stop.is_set() or self._ended):
                problem = self._run_process()
                if not (self._stop.is_set() or self._ended):
                    self._note_failure(problem)
                    self._stop.wait(_PAUSE_S)
        except TactuneError as error:
            self._error = error.with_traceback(None)  # otherwise the traceback would keep the shared memory
        except Exception as error:  # a caller that waits for a frame must get this error
            self._error = SourceError(f"{self._name}: capturing failed ({type(error).__name__}: {error})")
        finally:
            with self._changed:
                if self._stop.is_set():
                    self._waiting.clear()
                    self._error = SourceError(f"{self._name}: the source is closed; open it again")
                self._changed.notify_all()

    def _run_process(self) -> TactuneError | str:
        """Run one process to its end; return its error, or why it ended."""
        process = _Process(self._order)
        problem: TactuneError | str = ""
        try:
            problem = self._serve(process)
        finally:
            with self._changed:
                self._serving = None
            ending = process.end(politely=not (isinstance(problem, str) and problem))
        return problem or ending

    def _serve(self, process: _Process) -> TactuneError | str:
        """Obey messages until the process ends or hangs; return its error, or how it hangs, or an empty string."""
        memory: SharedMemory | None = None
        silent, patience_s = 0, _SILENT_OPENING_S
        while not self._stop.is_set():
            try:
                message = process.receive()
            except (EOFError, OSError):
                return ""
            # Waits are counted, not timed: while this process itself was stopped, the other one's messages were queued.
            silent = silent + 1 if message is None else 0
            if silent * POLL_S >= patience_s:
                return f"has given no sign of life for {patience_s:.0f} s"
            if isinstance(message, Opened):
                memory, patience_s = SharedMemory(message.memory), _SILENT_FIRST_S
                memory.unlink()  # both processes have it, so the system frees it with them
                self._use(process, message)
            elif isinstance(message, FrameReady) and memory is not None:
                patience_s = _SILENT_S
                self._take(process, memory, message)
            elif isinstance(message, Ended):
                if message.error is not None:
                    return message.error
                with self._changed:
                    self._ended = True
                    self._changed.notify_all()
            elif message is not None:
                self._note(message)
        return ""

    def _use(self, process: _Process, opened: Opened) -> None:
        """Continue with a process that has opened the source; check that the rig is the same."""
        before = self._opened
        if before is not None:
            if opened.rig != before.rig:
                raise SourceError(f"{before.name}: after a restart it has other cameras than before; open it again")
            for (camera, name), value in list(self.kept_options.items()):
                process.send(Call(next(self._numbers), "set_option", (camera, name, value)))
        with self._changed:
            self._notice_until_s = time.monotonic() + _NOTICE_S
            self._health = opened.health
            self._opened = before or opened
            self._serving = process
            self._changed.notify_all()

    def _take(self, process: _Process, memory: SharedMemory, ready: FrameReady) -> None:
        """Queue a frame; drop the oldest one if the queue is full."""
        with self._changed:
            self._waiting.append((process, memory, ready))
            oldest = None
            if len(self._waiting) > _MAX_WAITING:
                oldest = self._waiting.popleft()
                self._dropped += 1
            self._stale = False
            self._changed.notify_all()
        if oldest is not None:
            oldest[0].send(oldest[2].slot)

    def _note(self, message: Opening | Health | Reply) -> None:
        with self._changed:
            if isinstance(message, Opening):
                self._opening = message
            elif isinstance(message, Health):
                self._health = message
            elif message.number in self._replies:
                self._replies[message.number] = message
            self._changed.notify_all()

    def _note_failure(self, problem: TactuneError | str) -> None:
        """Keep the problem for the health message; raise it where the source has never been open."""
        if self._opened is None:
            if isinstance(problem, TactuneError):
                raise problem
            raise SourceError(f"{self._name}: the capture process {problem} while opening")
        with self._changed:
            self._stale = True
            what = f"Capturing failed: {str(problem).rstrip('.')}." if isinstance(problem, TactuneError) else ""
            self._notice = f"{what or f'The capture process {problem}.'} It is started again."
            self._notice_until_s = math.inf
            stalled = (replace(camera, state="stalled", message=self._notice) for camera in self._health.cameras)
            self._health = Health(cameras=tuple(stalled))


class _Process:
    """One capture process and its pipe; a restart makes another one."""

    def __init__(self, order: bytes) -> None:
        self._connection, theirs = _SPAWN.Pipe()
        self._sending = Lock()
        self._process = _SPAWN.Process(target=main, args=(theirs, order), name="tactune capture", daemon=True)
        try:
            with _as_imported_program():
                self._process.start()
        except OSError as error:
            self._connection.close()
            raise SourceError(f"no capture process can be started ({error}); check {sys.executable}") from error
        finally:
            theirs.close()

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
        return f"ended with status {self._process.exitcode}"


@contextmanager
def _as_imported_program() -> Iterator[None]:
    """Keep `multiprocessing` from running the caller's script again: a robot's script then needs no main guard."""
    own = multiprocessing.current_process()
    with _spawning:
        script, sys.modules["__main__"] = sys.modules["__main__"], ModuleType("__main__")
        daemonic, own.daemon = own.daemon, False
        try:
            yield
        finally:
            own.daemon = daemonic
            sys.modules["__main__"] = script
