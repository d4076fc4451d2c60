"""The check for drift while a live source runs: it tells what changed, and offers the re-check."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from PyQt6.QtCore import QObject
from PyQt6.QtGui import QAction

from ...core.rig.drift import INTERVAL_S, Watch, WatchReport
from ...widgets.basics.messages import Severity
from ..context import Context
from ..worker.jobs import Job
from .untouched_window import UntouchedKeeper

_KEY = "watch"


class WatchControl(QObject):
    """Looks at one frame in ten seconds of a live source, on another thread, while its action is ticked."""

    def __init__(self, context: Context, keeper: UntouchedKeeper, action: QAction, recheck: Callable[[], None]) -> None:
        super().__init__(context)
        self._context, self._keeper, self._action, self._recheck = context, keeper, action, recheck
        self._watch: Callable[[], Watch] | None = None
        self._key: object = None
        self._next_s = float("-inf")
        self._failed = False
        self._job = Job(self)
        self._job.done.connect(self._tell)
        self._job.failed.connect(self._fail)
        context.frameShown.connect(self._look)
        context.worker.opened.connect(self._forget)
        action.toggled.connect(self._forget)

    @property
    def busy(self) -> bool:
        return self._job.busy

    def close(self) -> None:
        self._job.stop()

    def _forget(self) -> None:
        self._key = None
        self._job.stop()
        self._context.worker.set_cameras_moved(False)
        self._context.messages.clear(_KEY)

    def _look(self) -> None:
        """Look at the shown frame if that is due."""
        result, untouched = self._context.result, self._keeper.frame
        if result is None or result.source.length is not None or not self._action.isChecked():
            return
        if untouched is None or self._keeper.busy or self._job.busy:
            return
        preset, rig = self._context.document.preset, result.source.rig
        # The other fields only decide what counts as touched; changing them must not forget earlier looks.
        key = (untouched, preset.alignment, result.source)
        if key != self._key:
            self._forget()
            self._key, self._next_s, self._failed = key, float("-inf"), False
            self._watch = cache(lambda: Watch(preset, rig, untouched))  # made on the thread of the job
        time_s = result.frame.proximity_time_s
        if self._failed or self._next_s - INTERVAL_S <= time_s < self._next_s:
            return
        self._next_s = time_s + INTERVAL_S
        watch, frame = self._watch, result.frame
        assert watch is not None
        self._job.start(lambda _: watch().look(frame, time_s))

    def _tell(self, report: WatchReport | None) -> None:
        if report is None:
            return
        self._context.worker.set_cameras_moved(report.verdict == "camera" and report.state == "told")
        if report.state == "withdrawn":
            self._context.messages.clear(_KEY)
        else:
            result = self._context.result
            two = result is not None and result.source.rig.has_proximity
            offers = [("Re-check…", self._recheck)] if two else []
            self._context.messages.show_message(_KEY, Severity.WARNING, report.sentence, offers)

    def _fail(self, sentence: str) -> None:
        self._failed = True  # the same untouched frame would fail again
        if sentence:
            self._context.messages.show_message(_KEY, Severity.INFO, f"Drift is not watched: {sentence}")
