"""The order of an interference test: emitter on, settle, gather; off, settle, gather; and back, whatever happens."""

from __future__ import annotations

import time

from PyQt6.QtCore import QObject, QTimer, pyqtSignal

from ...core.model.arrays import Uint16Array
from ...core.rig.depth_quality import NOISE_FRAMES
from ...core.rig.interference import emitter_switch, measure_interference, on_value
from ...core.sources.base import CameraOption
from ..worker.jobs import Job
from ..worker.results import Result, SourceInfo
from ..worker.worker import Worker

#: Exposure and depth need this long to settle after the switch.
SETTLE_S = 1.0
#: No frame for so long, or a switch that is not obeyed, ends the test.
PATIENCE_S = 5.0
_TICK_MS = 100


class InterferenceFlow(QObject):
    """Switches the emitter through the worker and gathers the tactile camera's depth.

    The emitter's former value is set again on every way out: done, cancelled, failed, window closed.

    Signals
    -------
    progress(share: float, words: str)
    done(Interference)
    failed(sentence: str)
        The sentence is empty where it was cancelled.
    """

    progress = pyqtSignal(float, str)
    done = pyqtSignal(object)
    failed = pyqtSignal(str)

    def __init__(self, worker: Worker, parent: QObject | None = None, settle_s: float = SETTLE_S) -> None:
        super().__init__(parent)
        self._worker, self._settle_s = worker, settle_s
        self._options: tuple[CameraOption, ...] = ()
        self._switch: CameraOption | None = None
        self._info: SourceInfo | None = None
        self._halves: list[list[Uint16Array]] = []
        self._obeyed_s: float | None = None
        self._heard_s = 0.0
        self._job = Job(self)
        self._job.done.connect(self.done)
        self._job.failed.connect(self.failed)
        self._watch = QTimer(self)
        self._watch.setInterval(_TICK_MS)
        self._watch.timeout.connect(self._look)

    @property
    def busy(self) -> bool:
        """Whether a test is going on."""
        return self._switch is not None or self._job.busy

    @property
    def has_proximity_camera(self) -> bool:
        """Whether the present source has a proximity camera that can be set at all."""
        return any(option.camera == "proximity" for option in self._options)

    @property
    def switch(self) -> CameraOption | None:
        """The option that switches the emitter of the present source; None where there is none."""
        return emitter_switch(self._options)

    def set_options(self, options: tuple[CameraOption, ...]) -> None:
        """Take the settings of the source's cameras; they tell when a switch is obeyed."""
        self._options = options
        if self._switch is None or self._obeyed_s is not None:
            return
        wanted = self._wanted()
        if any((o.camera, o.name, o.value) == ("proximity", self._switch.name, wanted) for o in options):
            self._obeyed_s = self._heard_s = time.monotonic()

    def start(self, info: SourceInfo) -> None:
        """Begin with the emitter on."""
        if self.busy or self.switch is None:
            return
        self._switch, self._info, self._halves = self.switch, info, [[]]
        self._order()
        self._watch.start()

    def take(self, result: Result) -> None:
        """Take a frame of the main window."""
        if self._switch is None:
            return
        if result.source is not self._info:
            self._switch = None  # its source has been closed, which put it back
            self._watch.stop()
            self.failed.emit("another source was opened meanwhile: test again")
            return
        now = time.monotonic()
        if self._obeyed_s is None:
            return
        self._heard_s = now
        if now - self._obeyed_s < self._settle_s:
            return
        half = self._halves[-1]
        if not half or half[-1] is not result.frame.tactile_depth:
            half.append(result.frame.tactile_depth)
        self._tell()
        if len(half) >= NOISE_FRAMES:
            self._next()

    def refuse(self, sentence: str) -> None:
        """Take a refusal of the camera."""
        if self._switch is not None:
            self._end(sentence)

    def cancel(self) -> None:
        """Give the test up and put the emitter back."""
        self._end("")
        self._job.cancel()

    def stop(self) -> None:
        """Give up for good: put the emitter back and wait for the thread."""
        self._put_back()
        self._job.stop()

    def _wanted(self) -> float:
        assert self._switch is not None
        return on_value(self._switch) if len(self._halves) == 1 else 0.0

    def _order(self) -> None:
        assert self._switch is not None
        self._obeyed_s, self._heard_s = None, time.monotonic()
        self._tell()
        self._worker.set_option("proximity", self._switch.name, self._wanted(), at_close=self._switch.value)

    def _next(self) -> None:
        if len(self._halves) == 1:
            self._halves.append([])
            self._order()
            return
        on, off = self._halves
        info = self._info
        assert info is not None
        self._put_back()
        self._job.start(lambda _: measure_interference(on, off, info.rig.tactile))

    def _look(self) -> None:
        """End a test that gets no further."""
        if time.monotonic() - self._heard_s < PATIENCE_S:
            return
        if self._obeyed_s is None:
            self._end("the proximity camera does not say that it obeyed; check it, and test again")
        else:
            self._end("no frames come any more; check the cameras, and test again")

    def _end(self, sentence: str) -> None:
        if self._switch is not None:
            self._put_back()
            self.failed.emit(sentence)

    def _put_back(self) -> None:
        self._watch.stop()
        switch, self._switch = self._switch, None
        if switch is not None:
            self._worker.set_option("proximity", switch.name, switch.value)

    def _tell(self) -> None:
        state = "on" if len(self._halves) == 1 else "off"
        gathered = len(self._halves[-1])
        doing = f"frame {gathered} of {NOISE_FRAMES}" if gathered else "waiting for it to settle"
        share = (len(self._halves) - 1 + gathered / NOISE_FRAMES) / 2
        self.progress.emit(share, f"Laser {state}: {doing}")
