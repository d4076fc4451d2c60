"""A panel that takes frames of the main window, works on them on another thread, and applies what it finds."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Final

from PyQt6.QtCore import pyqtSignal
from PyQt6.QtWidgets import QWidget

from ...core.errors import TactuneError, as_sentence, counted
from ...core.model.frames import SensorFrame
from ...core.rig.untouched import frames_to_average
from ...core.sources.base import part_of
from ...widgets.basics.controls import ProgressBar, keep_place, push_button, timer, wrapped_label
from ..context import Context
from ..worker.jobs import Job, Progress, Work
from ..worker.results import SourceInfo

#: Seconds without a frame after which a source counts as stopped.
PATIENCE_S: Final = 5.0
_TICK_MS: Final = 100
#: Share of the progress at which all frames have arrived.
_GATHERED: Final = 0.5
NO_FRAME: Final = "There is no frame yet: open a source in the main window first."
NO_MORE_FRAMES: Final = "No more frames arrive: play the source, in a loop if it is a recording, and start again."
OTHER_SOURCE: Final = "Another source was opened meanwhile: start again."
OTHER_TASK: Final = "Another window takes frames at present: cancel that first, or wait."


class MeasuringStep(QWidget):
    """Base of panels that take frames, of a recording too, work on them, and change the preset as one undo step."""

    #: Its name, also in the Edit menu, and what it wants.
    title, intro = "", ""
    #: Text, tooltip and, where there is one, key of the button that begins.
    button: tuple[str, ...]
    #: The preset field that the result, a model, becomes; empty for none.
    field = ""
    #: Number of different frames that are wanted, and the fewest that are enough.
    wanted, min_frames = 1, 1
    #: Whether the simulator makes frames for it without its object; else those that the main window plays are taken.
    at_rest = True
    #: What to do while frames of cameras are taken, and what happens to those of a recording.
    prompt, recorded = "Hold everything still", "Reading frames"

    ended = pyqtSignal(bool)  # whether there is a result; not, if it failed or was cancelled
    _takingFailed = pyqtSignal(str)

    def __init__(self, context: Context) -> None:
        super().__init__()
        self._context, self._document = context, context.document
        self.start = push_button(*self.button)
        self.cancel = push_button("Cance&l", "Cancel; the preset is unchanged")
        self.sentence = wrapped_label(selectable=True)
        self.progress = ProgressBar()
        keep_place(self.progress)
        #: The newest result; None before the first, and while another one is found.
        self.found: Any = None
        self.info: SourceInfo | None = None
        self._kept: dict[int, Any] = {}
        self._taking = self._preparing = False
        self._return_to: int | None = None
        self._counted, self._last_s = 0, 0.0
        self._timer = timer(self, _TICK_MS, self._look)
        self._job = Job(self, self._done, self._fail)
        self._job.progress.connect(
            lambda share, words: self.progress.show_share(_GATHERED + (1 - _GATHERED) * share, words)
        )
        self._takingFailed.connect(self._give_up)
        self.start.clicked.connect(self.begin)
        self.cancel.clicked.connect(self.stop)
        context.worker.opened.connect(self._source_opened)

    # What a panel says of itself

    def keep(self, frame: SensorFrame) -> Any:
        """Return what is kept of a frame; called on the thread that reads it."""
        return frame

    def share(self, kept: Sequence[Any]) -> float:
        """Return which share of what is wanted has been kept; 1 or more: enough."""
        return len(kept) / self.wanted

    def work(self, kept: list[Any], info: SourceInfo) -> Work:
        """Return the work on what will be in the list by then; it runs on another thread."""
        raise NotImplementedError

    def show_found(self, found: Any) -> None:
        """Show a result."""
        raise NotImplementedError

    def changes(self) -> dict[str, Any]:
        """Return the preset fields that the result changes, and their new values."""
        return {self.field: self.found.model_dump()} if self.field else {}

    def untouched_of(self, info: SourceInfo) -> Callable[[Progress], SensorFrame | None]:
        """Return the work that finds the preset's untouched frame, or the source's."""
        preset, home = self._document.preset, self._document.untouched_home
        return lambda progress: info.find_untouched(preset, home, progress).frame

    def at_hand(self) -> list[Any]:
        """Return what is worked on at once, without taking frames; empty if frames are to be taken."""
        return []

    def prepare(self, info: SourceInfo) -> Work | None:
        """Return the work that is done on another thread before frames are taken; `prepared` gets its result."""
        return None

    def prepared(self, found: Any) -> None:
        """Keep what was prepared."""

    # Taking frames

    @property
    def doing(self) -> str:
        """What to do while frames are taken; what happens, if nobody can do anything."""
        if self.info is not None and self._simulated(self.info):
            return "Using frames without the object, made by the simulator"
        if self._job.busy and not self._preparing:
            return "Computing"
        return self.prompt if self.info is None or self.info.length is None else self.recorded

    def _simulated(self, info: SourceInfo) -> bool:
        return self.at_rest and info.name.startswith("sim:")

    @property
    def busy(self) -> bool:
        return self._taking or self._job.busy

    def begin(self) -> None:
        result, recorder = self._context.result, self._context.worker.recorder
        if self.busy:
            return
        self.found = None
        if result is None or recorder.watched:
            self._fail(NO_FRAME if result is None else OTHER_TASK)
            return
        info = self.info = result.source
        if info.length is not None and info.length < self.min_frames:
            self._fail(f"This source has {counted(info.length, 'frame')}; at least {self.min_frames} are needed.")
            return
        self.sentence.clear()
        self.progress.show_share(0.0, "")
        frames, prepare = self.at_hand(), self.prepare(info)
        if frames or self._simulated(info):
            work = self.work(frames, info)
            self._job.start(work if frames else partial(_simulated, info, self.wanted, frames, work))
        elif prepare is not None:
            self._preparing = True
            self._job.start(prepare)
        else:
            self._take()
        self._show_busy()

    def _take(self) -> None:
        result, recorder = self._context.result, self._context.worker.recorder
        assert result is not None
        if recorder.watched:  # by another window that began while this one prepared
            self._fail(OTHER_TASK)
            return
        self._taking = True
        kept: dict[int, Any] = {}

        def take(frame: SensorFrame) -> None:
            if frame.sequence not in kept:
                kept[frame.sequence] = self.keep(frame)

        self._kept, self._counted, self._last_s = kept, 0, time.monotonic()
        playback = self._context.playback or result.playback  # the newest state: that of the frame may be older
        self._return_to = playback.index if playback.seekable and not playback.playing else None
        try:
            take(result.frame)
        except TactuneError as error:
            self._give_up(str(error))
            return
        recorder.watch(take, self._takingFailed.emit)
        self._timer.start()
        self._context.worker.play()  # also where a pause is on its way that the newest frame does not know of

    def stop(self) -> None:
        was_taking, was_busy = self._taking, self.busy
        self._stop_taking()
        self._job.cancel()
        if was_busy:
            self.sentence.setText("Cancelled; nothing was changed.")
        self._show_busy()
        if was_taking:  # else the job ends it
            self.ended.emit(False)

    def close_down(self) -> None:
        self._stop_taking()
        self._job.stop()
        self._show_busy()

    def _stop_taking(self) -> None:
        if not self._taking:
            return
        self._taking = False
        self._timer.stop()
        worker = self._context.worker
        worker.recorder.unwatch()
        if self._return_to is not None:
            worker.pause()
            worker.seek(self._return_to)

    def _look(self) -> None:
        """Work on the frames once there are enough, or once no more come."""
        assert self.info is not None
        now, count = time.monotonic(), len(self._kept)
        if count > self._counted:
            self._counted, self._last_s = count, now
        share = self.share(list(self._kept.values()))
        self.progress.show_share(_GATHERED * min(share, 1.0), f"{self.doing}: {counted(count, 'frame')}")
        if share >= 1.0 or count == self.info.length:
            self._end_taking()
        elif now - self._last_s > PATIENCE_S:
            if count >= self.min_frames:
                self._end_taking()
            else:
                self._give_up(NO_MORE_FRAMES)

    def _end_taking(self) -> None:
        assert self.info is not None
        self._stop_taking()
        kept, self._kept = list(self._kept.values()), {}
        self._job.start(self.work(kept, self.info))
        self._show_busy()

    def _give_up(self, sentence: str) -> None:
        if self._taking:
            self._stop_taking()
            self._fail(sentence)

    def _source_opened(self, info: SourceInfo) -> None:
        if self.info is not None and info is not self.info and self.busy:
            self._return_to = None  # a place in the other source
            self._stop_taking()
            self._job.cancel()
            self._fail(OTHER_SOURCE)

    # The result

    def _done(self, found: Any) -> None:
        if self._preparing:
            self._preparing = False
            self.prepared(found)
            self._take()
            self._show_busy()
            return
        self.found = found
        self._show_busy()
        self.show_found(found)
        if changes := self.changes():
            self._document.edit_many(changes, title=self.title)
        self.ended.emit(True)

    def _fail(self, sentence: str) -> None:
        self._preparing = False
        self._show_busy()
        if sentence:  # empty: it was cancelled
            self.sentence.setText(as_sentence(sentence))
        self.ended.emit(False)

    def _show_busy(self) -> None:
        self.start.setEnabled(not self.busy)
        self.cancel.setEnabled(self.busy)
        self.progress.setVisible(self.busy)


def _simulated(info: SourceInfo, count: int, frames: list[SensorFrame], work: Work, progress: Progress) -> Any:
    """Make frames of the simulator without its object, then work on them."""
    assert info.at_rest is not None
    with frames_to_average(info.at_rest, count, part_of(progress, 0, 3)) as shown:
        for frame in shown:
            frames.append(frame)
            part_of(progress, 1, 3)(len(frames) / count, f"Frame {len(frames)} of {count}")
    return work(part_of(progress, 2, 3))
