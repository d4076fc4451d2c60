"""The worker thread: reads frames, finds the contact patch, draws what is visible.

A recording is read when a frame is due. A live source is read on its own thread, which stores the newest
frame and wakes the worker, so orders are obeyed at once while no frame comes.

The window never waits for the worker. Orders go in through a queue; results come out of a one-slot mailbox.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Final

from PyQt6.QtCore import QObject, QThread, pyqtSignal

from ...core.model.frames import SensorFrame
from ...core.model.patch import Lazy
from ...core.output.publisher import Publisher
from ...core.preset import Preset
from ...core.sources.base import CameraOption, CameraRole, FrameSource
from ..document.comparison import Sides
from .background import BackgroundCompiler, Examination, StoredUntouched
from .errors import explain, guarded
from .playback import Playback
from .processing import FrameProcessor
from .reading import PATIENCE_S, FrameReader, LiveReader, SourceRequest, open_requested
from .recorder import Recorder
from .results import Result, SourceInfo, SourceState, Wanted
from .threads import Mailbox, abandon, leave_room_for_the_window

if TYPE_CHECKING:
    from ...core.estimation.pose import PoseEstimate

#: Grace period before a hung worker is abandoned, in ms; longer than that of a live source.
PATIENCE_MS = round(1e3 * PATIENCE_S) + 2000
#: Pause after each frame while a contact test is compiled, which takes turns with Python code.
PAUSE_S = 0.15
NOT_LIVE: Final = (
    "Only cameras and other live sources are recorded: connect cameras (F3), or export a part of this recording "
    "(File > Export)."
)


class Worker(QThread):
    """Owns the source and the pipeline; every public method may be called from the GUI thread."""

    resultReady = pyqtSignal()  # `take` has a new result
    opening = pyqtSignal(str, float, str)  # name, share done, step
    opened = pyqtSignal(object)  # SourceInfo
    openFailed = pyqtSignal(str, str)  # name, sentence or "" if cancelled; the former source continues
    failed = pyqtSignal(str)  # reading or processing: a recording pauses, a live source continues
    recovered = pyqtSignal()  # a frame of a live source was processed again
    playbackChanged = pyqtSignal(object)  # PlaybackState; each result carries its frame number
    stateChanged = pyqtSignal(object)  # SourceState, also while no frame comes
    optionsChanged = pyqtSignal(object)  # tuple of CameraOption, empty for recordings
    optionRefused = pyqtSignal(str)
    examined = pyqtSignal(object, object)  # tuple of Finding on the newest frame, Preset
    recordingStarted = pyqtSignal(object)  # Path
    recordingFailed = pyqtSignal(str)  # it cannot be started
    recordingEnded = pyqtSignal(object, str)  # RecordingStatus, why it stopped by itself

    def __init__(self, preset: Preset, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self.recorder = Recorder(self.recordingEnded.emit)
        self._orders: SimpleQueue[Callable[[], object]] = SimpleQueue()
        self._mailbox: Mailbox[Result] = Mailbox(
            lambda old, new: old.frame is new.frame or old.source is not new.source
        )
        self._request: SourceRequest | None = None
        self._stopping = False
        self._playback = Playback()
        self._preset = preset
        self._wanted = Wanted()
        self._compared: Sides | None = None
        self._untouched = StoredUntouched()
        self._compiler = BackgroundCompiler(lambda: self._orders.put(lambda: setattr(self, "_redo", True)))
        self._processor = FrameProcessor(self._compiler.missing, self._untouched)
        self._examination = Examination()
        self._reader: FrameReader | None = None
        self._live: LiveReader | None = None
        self._state = SourceState()
        self._info: SourceInfo | None = None
        self._frame: SensorFrame | None = None
        self._newest: SensorFrame | None = None
        self._failing = False
        self._dropped_before = 0  # with former sources
        self._told = self._playback.state
        self._redo = False
        self._publisher: Publisher | None = None

    # Orders, from any thread

    def take(self) -> Result | None:
        return self._mailbox.take()

    def open(self, request: SourceRequest) -> None:
        """Open a source and, once that has succeeded, play it; one that is still opening is cancelled."""
        self._request = request
        self._orders.put(lambda: self._open(request))

    def cancel_open(self) -> None:
        self._request = None

    def set_preset(self, preset: Preset, untouched_home: Path | None = None) -> None:
        """Use another preset, with its untouched frame beside ``untouched_home``; a paused frame is processed again."""
        self._orders.put(lambda: setattr(self._untouched, "home", untouched_home))
        self._orders.put(lambda: self._change("_preset", preset))

    def set_compared(self, sides: Sides | None) -> None:
        """Process every frame with two presets as well, or with None only with the present one."""
        self._orders.put(lambda: self._change("_compared", sides))

    def set_publisher(self, publisher: Publisher | None) -> None:
        self._publisher = publisher
        self._orders.put(lambda: setattr(self, "_redo", True))  # a paused frame is published, too

    def put_pose(self, pose: PoseEstimate) -> None:
        """Publish the pose of a tracked object that is not lost, while publishing runs."""
        if (publisher := self._publisher) is not None:
            publisher.put_pose(pose.T_proximity_object, pose.covariance, pose.time_s)

    def set_wanted(self, wanted: Wanted) -> None:
        self._orders.put(lambda: self._change("_wanted", wanted))

    def play(self) -> None:
        self._orders.put(self._playback.play)

    def pause(self) -> None:
        """Pause at the present frame; a live source keeps streaming."""
        self._orders.put(self._stand_still)

    def step(self, by: int) -> None:
        self._orders.put(lambda: self._step(by))

    def seek(self, index: int) -> None:
        """Show frame ``index`` and stay in the present state, playing or paused."""
        self._orders.put(lambda: self._show(index))

    def set_loop(self, loop: bool) -> None:
        self._orders.put(lambda: setattr(self._playback, "loop", loop))

    def set_speed(self, speed: float) -> None:
        self._orders.put(lambda: setattr(self._playback, "speed", speed))

    def set_held(self, held: bool) -> None:
        self._orders.put(lambda: setattr(self._playback, "held", held))

    def set_cameras_moved(self, moved: bool) -> None:
        """Say in the doubt about patches that a check for drift found a moved camera, until another source is open."""

        def say() -> None:
            self._processor.set_cameras_moved(moved)
            self._redo = True

        self._orders.put(say)

    def set_option(self, camera: CameraRole, name: str, value: float) -> None:
        self._orders.put(lambda: self._set_option(camera, name, value))

    def start_recording(self, path: Path) -> None:
        self._orders.put(lambda: self._start_recording(path))

    def stop_recording(self, reason: str = "") -> None:
        self._orders.put(lambda: self.recorder.stop(reason))

    def shut_down(self) -> None:
        """Stop, finish a recording and close the source; a hung source is abandoned."""
        self._request = None
        self._orders.put(lambda: setattr(self, "_stopping", True))
        self.recorder.close()  # the recorded frames are kept, however slow the disk is
        if not self.wait(PATIENCE_MS):
            logging.getLogger(__name__).warning(
                "The source is still busy while the window closes; its thread was abandoned."
            )
            abandon(self)

    # The thread

    def run(self) -> None:
        leave_room_for_the_window()
        try:
            while True:
                self._tell_playback()
                self._obey(self._idle_s())
                if self._stopping:
                    break
                self._tell_playback()
                self._carry_on()
                self._examine()
        finally:
            self._close_source()
            self.recorder.close()
            self._compiler.stop()

    def _carry_on(self) -> None:
        """Process what is due: a new frame, or the present one again."""
        newest = self._newest
        if newest is not None and newest is not self._frame and self._playback.playing:
            self._playback.shown(newest.sequence, time.perf_counter())
            self._frame = newest
            self._process(newest)
            return
        due = self._reader is not None and self._playback.wait_s(time.perf_counter()) == 0.0
        if self._redo and self._frame is not None and not due:
            self._process(self._frame)
        elif due:
            self._advance()

    def _examine(self) -> None:
        if self._examination.wait_s() == 0.0:
            guarded(lambda: self.examined.emit(*self._examination.findings()))

    def _tell_playback(self) -> None:
        mode = replace(self._playback.state, index=-1)
        if mode != self._told:
            self._told = mode
            self.playbackChanged.emit(self._playback.state)

    def _idle_s(self) -> float | None:
        """Seconds until the next frame is due; None: wait for orders only."""
        if self._redo and self._frame is not None:
            return 0.0
        playback_s = self._playback.wait_s(time.perf_counter()) if self._reader is not None else None
        waits = [wait for wait in (playback_s, self._examination.wait_s()) if wait is not None]
        idle_s = min(waits, default=None)
        return max(idle_s, PAUSE_S) if idle_s is not None and self._compiler.busy else idle_s

    def _obey(self, idle_s: float | None) -> None:
        """Wait up to ``idle_s`` for the first order, then obey all that are waiting."""
        try:
            order = self._orders.get(timeout=idle_s) if idle_s != 0.0 else self._orders.get_nowait()
            while True:
                guarded(order)
                order = self._orders.get_nowait()
        except Empty:
            return

    def _change(self, name: str, value: Any) -> None:
        setattr(self, name, value)
        self._redo = True

    def _open(self, request: SourceRequest) -> None:
        if request.exclusive and self._live is not None:
            closed = f"{self._live.source.name} was closed for {request.name}."
            self._close_source(f"{request.name} is being opened")
            self._tell_state(SourceState(stale=True, problem=closed))
        try:
            source = open_requested(
                request,
                lambda: self._request is request,
                lambda fraction, text: self.opening.emit(request.name, fraction, text),
            )
        except Exception as error:
            wanted = self._request is request
            self.openFailed.emit(request.name, explain(error, f"{request.name} could not be opened") if wanted else "")
            return
        self._use_source(source)

    def _use_source(self, source: FrameSource) -> None:
        self._close_source(f"{source.name} was opened")
        self._info = SourceInfo.of(source)
        self._dropped_before = self._mailbox.dropped
        self._processor.forget()
        self._examination.forget()
        self._untouched.forget()
        self._playback.start_source(source.length, source.frame_rate_hz)
        self.opened.emit(self._info)
        if source.length is None:
            self._live = LiveReader(source, self.recorder.put, self)
            return
        self._reader = FrameReader(source)
        self.optionsChanged.emit(source.options())
        self._tell_state(SourceState(source.health()))
        if not self._playback.playing:
            self._show(0)

    def _close_source(self, reason: str = "") -> None:
        self.recorder.stop(reason)
        for reader in (self._live, self._reader):
            if reader is not None:
                reader.close()
        self._live, self._reader, self._frame, self._newest = None, None, None, None
        self._state = SourceState()

    # Events of the live reader, on its thread

    def frame_arrived(self, reader: LiveReader) -> None:
        self._orders.put(lambda: self._take_newest(reader))

    def state_changed(self, reader: LiveReader, state: SourceState) -> None:
        self._orders.put(lambda: self._tell_state(state) if reader is self._live else None)

    def options_changed(self, reader: LiveReader, options: tuple[CameraOption, ...]) -> None:
        self._orders.put(lambda: self.optionsChanged.emit(options) if reader is self._live else None)

    def option_refused(self, reader: LiveReader, sentence: str) -> None:
        self._orders.put(lambda: self.optionRefused.emit(sentence) if reader is self._live else None)

    # Steps

    def _take_newest(self, reader: LiveReader) -> None:
        if reader is self._live:
            self._newest = reader.take() or self._newest

    def _tell_state(self, state: SourceState) -> None:
        if state != self._state:
            self._state = state
            self.stateChanged.emit(state)

    def _set_option(self, camera: CameraRole, name: str, value: float) -> None:
        if self._live is not None:
            self._live.set_option(camera, name, value)
        else:
            self.optionRefused.emit("No camera is open: connect cameras (F3) to change their settings.")

    def _start_recording(self, path: Path) -> None:
        if self._info is None or self._live is None:
            self.recordingFailed.emit(NOT_LIVE)
            return
        if self.recorder.status() is not None:  # the key was pressed twice before the window heard of the first
            return
        try:
            untouched = self._untouched(self._info, self._preset).frame
            self.recorder.start(path, self._info.rig, self._preset, self._info.frame_rate_hz, untouched)
        except Exception as error:
            self.recordingFailed.emit(explain(error, f"{path} cannot be recorded"))
            return
        self.recordingStarted.emit(path)

    def _stand_still(self) -> None:
        self._playback.pause()
        self._redo = True  # a paused frame is drawn in full resolution

    def _step(self, by: int) -> None:
        self._playback.pause()
        index = self._playback.step_index(by)
        if index is not None:
            self._show(index)

    def _advance(self) -> None:
        index = self._playback.next_index()
        self._redo |= index is None  # the last frame stays, so all of it is drawn
        if index is not None and (frame := self._show(index)) is not None:
            self.recorder.put(frame, index)

    def _show(self, index: int) -> SensorFrame | None:
        """Read frame ``index`` of a recording, process and post it; return it."""
        if self._reader is None or self._info is None:
            return None
        started = time.perf_counter()
        try:
            frame = self._reader.read(index)
        except Exception as error:
            self._fail(explain(error, f"frame {index} of {self._info.name} could not be read"))
            return None
        if frame is None:
            self._stand_still()
            return None
        self._playback.shown(index, time.perf_counter())
        if self._playback.playing:
            self._reader.read_ahead(self._playback.following_index())
        self._tell_state(SourceState(self._reader.source.health()))
        self._frame = frame
        self._process(frame, read_ms=1e3 * (time.perf_counter() - started))
        return frame

    def _process(self, frame: SensorFrame, read_ms: float = 0.0) -> None:
        assert self._info is not None
        self._redo = False
        playback, held = self._playback.state, self._playback.held
        try:
            result = self._processor.process(
                self._info, frame, self._preset, self._wanted, playback, compared=self._compared, held=held
            )
        except Exception as error:
            self._fail(explain(error, f"frame {playback.index} of {self._info.name} could not be processed"))
            return
        health = self._state.health
        not_taken = self._mailbox.dropped - self._dropped_before + (self._live.dropped if self._live is not None else 0)
        dropped = not_taken + health.dropped
        result = replace(result, dropped=dropped, unmatched=health.unmatched, read_ms=read_ms)
        if self._failing:
            self._failing = False
            self.recovered.emit()
        if self._mailbox.put(result):
            self.resultReady.emit()
        if (publisher := self._publisher) is not None:
            _publish(publisher, result)
        self._compiler.start()  # after the first picture, which compiles, too
        self._examination.note(result)

    def _fail(self, sentence: str) -> None:
        if self._live is None:
            self._playback.pause()
        elif self._failing:
            return  # every frame fails: report it once
        self._failing = self._live is not None
        self.failed.emit(sentence)


def _publish(publisher: Publisher, result: Result) -> None:
    """Publish a frame with its patch and tilt; the tilt is computed if a client listens to it."""
    from ...core.estimation.tilt import TiltEstimator

    patch = result.patch
    if patch is not None:
        tilt = Lazy(lambda: TiltEstimator(result.preset, patch.rig).estimate(patch).record())
        publisher.put(result.frame, patch, result.preset, tilt)
