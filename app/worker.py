"""The worker: reads frames, finds the contact patch, draws what is looked at; one thread.

The window never waits for it. Orders go in through a queue; results come out through a one-slot
mailbox, with one wake-up however many frames were dropped in between.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from queue import Empty, SimpleQueue
from typing import Any

from PyQt6.QtCore import QObject, QThread, pyqtSignal

from ..core.errors import TactuneError
from ..core.frames import SensorFrame
from ..core.pipeline import ContactPatch, ContactPipeline
from ..core.preset import Preset
from ..core.sources.base import FrameSource
from .cores import leave_room_for_the_window
from .mailbox import Mailbox
from .playback import Playback
from .reader import FrameReader
from .rendering import Renderer
from .results import RateMeter, Result, SourceInfo, Wanted

#: Python's 5 ms between thread switches would make the window wait for the worker's Python code.
SWITCH_INTERVAL_S = 0.0005
_PROGRESS_INTERVAL_S = 0.05

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class SourceRequest:
    """A source to open: what to call it meanwhile and how to open it."""

    name: str
    open: Callable[[Progress], FrameSource]


class _OpeningCancelledError(TactuneError):
    """Raised inside a source that is being opened, to leave it."""


class Worker(QThread):
    """Owns the source and the pipeline; every public method may be called from the GUI thread.

    Signals
    -------
    resultReady()
        `take` has something new.
    opening(name: str, fraction: float, text: str)
    opened(SourceInfo)
    openFailed(name: str, sentence: str)
        The sentence is empty where opening was cancelled. The former source goes on.
    failed(sentence: str)
        Reading or processing a frame failed; playback is paused, the worker lives on.
    playbackChanged(PlaybackState)
        Playing, looping, frozen or the speed changed; the frame number comes with each result.
    """

    resultReady = pyqtSignal()
    opening = pyqtSignal(str, float, str)
    opened = pyqtSignal(object)
    openFailed = pyqtSignal(str, str)
    failed = pyqtSignal(str)
    playbackChanged = pyqtSignal(object)

    def __init__(self, preset: Preset, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._orders: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._mailbox: Mailbox[Result] = Mailbox(lambda old, new: old.frame is new.frame)
        self._request: SourceRequest | None = None
        self._stopping = False
        self._playback = Playback()
        self._preset = preset
        self._wanted = Wanted()
        self._renderer = Renderer()
        self._reader: FrameReader | None = None
        self._info: SourceInfo | None = None
        self._pipeline: ContactPipeline | None = None
        self._frame: SensorFrame | None = None
        self._told = self._playback.state
        self._stale = False
        self._processed = 0
        self._processed_rate = RateMeter()

    # Orders, from any thread

    def take(self) -> Result | None:
        """Take the newest result, or None."""
        return self._mailbox.take()

    def open(self, request: SourceRequest) -> None:
        """Open a source and, once that has succeeded, play it instead of the present one.

        A source that is still being opened is given up.
        """
        self._request = request
        self._orders.put(lambda: self._open(request))

    def cancel_open(self) -> None:
        """Stop opening; the present source goes on."""
        self._request = None

    def set_preset(self, preset: Preset) -> None:
        """Use another preset from the next frame on; a frame that stands still is done again."""
        self._orders.put(lambda: self._change("_preset", preset))

    def set_wanted(self, wanted: Wanted) -> None:
        """Say what is looked at; a frame that stands still is drawn again."""
        self._orders.put(lambda: self._change("_wanted", wanted))

    def play(self) -> None:
        """Play on from the present frame."""
        self._orders.put(self._playback.play)

    def pause(self) -> None:
        """Stand still at the present frame."""
        self._orders.put(self._stand_still)

    def step(self, by: int) -> None:
        """Pause and show the frame ``by`` frames away."""
        self._orders.put(lambda: self._step(by))

    def seek(self, index: int) -> None:
        """Show frame ``index`` and stay in the present state, playing or paused."""
        self._orders.put(lambda: self._show(index))

    def set_loop(self, loop: bool) -> None:
        """Start over at the end of a recording, or stop there."""
        self._orders.put(lambda: setattr(self._playback, "loop", loop))

    def set_speed(self, speed: float) -> None:
        """Play a recording faster or slower than it was taken."""
        self._orders.put(lambda: setattr(self._playback, "speed", speed))

    def set_frozen(self, frozen: bool) -> None:
        """Hold the present frame while a live source goes on; a recording waits."""
        self._orders.put(lambda: self._freeze(frozen))

    def set_held(self, held: bool) -> None:
        """Make a recording wait while the person drags its slider."""
        self._orders.put(lambda: setattr(self._playback, "held", held))

    def shut_down(self) -> None:
        """Stop, release the source and wait until the thread has ended."""
        self._request = None
        self._orders.put(lambda: setattr(self, "_stopping", True))
        self.wait()

    # The thread

    def run(self) -> None:
        """Obey orders and play frames until told to stop."""
        sys.setswitchinterval(SWITCH_INTERVAL_S)
        leave_room_for_the_window()
        try:
            while True:
                self._tell_playback()
                self._obey(self._idle_s())
                if self._stopping:
                    break
                self._tell_playback()
                due = self._reader is not None and self._playback.wait_s(time.perf_counter()) == 0.0
                if self._stale and self._frame is not None and (self._playback.frozen or not due):
                    self._process(self._frame)
                elif due:
                    self._advance()
        finally:
            if self._reader is not None:
                self._reader.close()

    def _tell_playback(self) -> None:
        """Tell of another mode of playback; the frame number comes with each result."""
        mode = replace(self._playback.state, index=-1)
        if mode != self._told:
            self._told = mode
            self.playbackChanged.emit(self._playback.state)

    def _idle_s(self) -> float | None:
        """How long there is nothing to do but wait for orders; None: for ever."""
        if self._stale and self._frame is not None:
            return 0.0
        return self._playback.wait_s(time.perf_counter()) if self._reader is not None else None

    def _obey(self, idle_s: float | None) -> None:
        """Carry out all orders that are waiting; wait for the first one as long as nothing else is due."""
        try:
            order = self._orders.get(timeout=idle_s) if idle_s != 0.0 else self._orders.get_nowait()
            while True:
                order()
                order = self._orders.get_nowait()
        except Empty:
            return

    def _change(self, name: str, value: Any) -> None:
        setattr(self, name, value)
        self._stale = True

    def _open(self, request: SourceRequest) -> None:
        last_report_s = 0.0

        def progress(fraction: float, text: str) -> None:
            nonlocal last_report_s
            if self._request is not request:
                raise _OpeningCancelledError(f"opening {request.name} was cancelled")
            if time.perf_counter() - last_report_s > _PROGRESS_INTERVAL_S:
                last_report_s = time.perf_counter()
                self.opening.emit(request.name, fraction, text)

        self.opening.emit(request.name, 0.0, "")
        try:
            source = request.open(progress)
        except Exception as error:
            sentence = "" if self._request is not request else explain(error, f"{request.name} could not be opened")
            self.openFailed.emit(request.name, sentence)
            return
        if self._request is not request:
            source.close()
            self.openFailed.emit(request.name, "")
            return
        self._use_source(source)

    def _use_source(self, source: FrameSource) -> None:
        if self._reader is not None:
            self._reader.close()
        self._reader = FrameReader(source)
        self._info = SourceInfo(source.name, source.rig, source.length, source.frame_rate_hz)
        self._pipeline = None
        self._frame = None
        self._playback.start_source(source.length, source.frame_rate_hz)
        self.opened.emit(self._info)
        if not self._playback.playing:
            self._show(0)

    def _stand_still(self) -> None:
        self._playback.pause()
        self._stale = True  # what stands still is drawn in full

    def _freeze(self, frozen: bool) -> None:
        self._playback.frozen = frozen
        self._stale = True

    def _step(self, by: int) -> None:
        self._playback.pause()
        self._playback.frozen = False
        index = self._playback.step_index(by)
        if index is not None:
            self._show(index)

    def _advance(self) -> None:
        index = self._playback.next_index()
        if index is not None:
            self._show(index)

    def _show(self, index: int) -> None:
        """Read frame ``index`` (of a live source: the next one), process and post it."""
        if self._reader is None or self._info is None:
            return
        started = time.perf_counter()
        try:
            frame = self._reader.read(index)
        except Exception as error:
            self._fail(explain(error, f"frame {index} of {self._info.name} could not be read"))
            return
        if frame is None:
            self._playback.pause()
            return
        self._playback.shown(index, time.perf_counter())
        if self._playback.playing and self._info.length is not None:
            self._read_ahead()
        if self._playback.frozen and self._frame is not None and self._info.length is None:
            return
        self._frame = frame
        self._process(frame, read_ms=1e3 * (time.perf_counter() - started))

    def _read_ahead(self) -> None:
        """Have the next frame read while this one is processed; errors appear when it is its turn."""
        following = self._playback.following_index()
        if self._reader is not None and following is not None:
            self._reader.read_ahead(following)

    def _process(self, frame: SensorFrame, read_ms: float = 0.0) -> None:
        assert self._info is not None
        self._stale = False
        try:
            patch, problem = self._find_patch(frame)
            started = time.perf_counter()
            wanted = self._wanted.while_running() if self._playback.state.running else self._wanted
            rendered = self._renderer.render(frame, patch, self._preset, self._info.rig, wanted)
            render_ms = 1e3 * (time.perf_counter() - started)
            area_mm2 = patch.area_mm2 if patch is not None else 0.0
        except Exception as error:
            self._fail(explain(error, f"frame {frame.sequence} of {self._info.name} could not be processed"))
            return
        self._processed += 1
        self._processed_rate.tick()
        source_health = self._reader.source.health() if self._reader is not None else None
        result = Result(
            source=self._info,
            frame=frame,
            preset=self._preset,
            patch=patch,
            area_mm2=area_mm2,
            rendered=rendered,
            playback=self._playback.state,
            problem=problem,
            warnings=tuple(self._pipeline.warnings) if self._pipeline is not None else (),
            health=source_health.message if source_health is not None else "",
            processed=self._processed,
            dropped=self._mailbox.dropped + (source_health.dropped if source_health is not None else 0),
            processed_fps=self._processed_rate.rate(),
            read_ms=read_ms,
            render_ms=render_ms,
        )
        if self._mailbox.put(result):
            self.resultReady.emit()

    def _find_patch(self, frame: SensorFrame) -> tuple[ContactPatch | None, str]:
        """Return the patch, or None and why this preset cannot be used with this rig."""
        assert self._info is not None
        try:
            if self._pipeline is None:
                self._pipeline = ContactPipeline(self._preset, self._info.rig)
            elif self._pipeline.preset is not self._preset:
                self._pipeline.update(self._preset)
            return self._pipeline.process(frame), ""
        except TactuneError as error:
            self._pipeline = None
            return None, str(error)

    def _fail(self, sentence: str) -> None:
        self._playback.pause()
        self.failed.emit(sentence)


def explain(error: Exception, what: str) -> str:
    """Turn an error into one sentence; the tool's own errors speak for themselves."""
    if isinstance(error, TactuneError):
        return str(error)
    return f"{what[0].upper()}{what[1:]} ({type(error).__name__}: {error})."
