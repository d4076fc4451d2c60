"""The check for drift: once when a source opens, then at intervals while it is live; and the window that shows it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

from PyQt6.QtCore import QObject
from PyQt6.QtGui import QAction, QCloseEvent
from PyQt6.QtWidgets import QDialog

from ...core.calibration.check import Drift
from ...core.errors import as_sentence
from ...core.rig.drift import (
    LOOKS,
    MembraneDrift,
    RigCheck,
    Watch,
    WatchReport,
    check_rig,
    drift_or_reason,
    remedies_of,
)
from ...widgets.basics.controls import push_button, wrapped_label
from ...widgets.basics.dialogs import bring_up
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from ...widgets.basics.messages import Offer, Severity
from ...widgets.images.marks import ARROW_FACTOR, Mark
from ...widgets.images.point_image import PointImage
from ..calibration.pictures import picture
from ..context import SOURCE, Context
from ..worker.jobs import Job

_KEY = "watch"
_CHECKING = "Searching the points in the current frame…"
_NO_FRAME = "There is no frame to check yet: open a source first."


class WatchControl(QObject):
    """Looks at single frames of the source on another thread, while its action is ticked.

    The first looks follow each other quickly: the first one at which nothing touches the membrane says whether the rig
    is still good. A recording gets these looks only.
    """

    def __init__(
        self,
        context: Context,
        action: QAction,
        calibrate: Callable[[], None],
        capture: Callable[[], None],
    ) -> None:
        super().__init__(context)
        self._context, self._action = context, action
        self._calibrate, self._capture = calibrate, capture
        self.window: DriftWindow | None = None
        #: What the first look at the untouched membrane found; None before it.
        self.first: RigCheck | None = None
        self._watch: Callable[[], Watch] | None = None
        self._key: object = None
        self._looks, self._failed = 0, False
        self.job = Job(self, done=self._tell, failed=self._fail)
        context.frameShown.connect(self._look)
        context.worker.opened.connect(self._forget)
        action.toggled.connect(self._forget)

    def open(self) -> None:
        """Check the frame on the screen in a window of its own."""
        if self.window is None:
            self.window = DriftWindow(self._context, self._calibrate, self._capture)
        bring_up(self.window)
        self.window.check()

    def close(self) -> None:
        self.job.stop()
        if self.window is not None:
            self.window.close()

    def _forget(self) -> None:
        self._key = self.first = None
        self.job.stop()
        self._context.worker.set_cameras_moved(False)
        self._context.messages.clear(_KEY)

    def _look(self) -> None:
        """Look at the shown frame if that is due."""
        result = self._context.result
        if result is None or result.patch is None or self.job.busy or not self._action.isChecked():
            return  # without a patch, nothing tells what is touched
        preset, rig, live, untouched = result.preset, result.source.rig, result.source.length is None, result.untouched
        if preset.untouched is None or untouched is None:
            return
        # The other fields only decide what counts as touched; changing them must not forget earlier looks.
        key = (untouched, preset.alignment, preset.contact_test, result.source)
        if key != self._key:
            self._forget()
            self._key, self._looks, self._failed = key, 0, False
            self._watch = cache(lambda: Watch(preset, rig, untouched))  # made on the thread of the job
        frame, watch, first = result.frame, self._watch, self.first is None
        time_s = frame.proximity_time_s
        assert watch is not None
        if self._failed or (not live and (self._looks >= LOOKS or not first)):
            return
        if self._looks and not watch().due(time_s):
            return
        self._looks += 1

        def look(_: object) -> tuple[WatchReport | None, RigCheck | None]:
            report, membrane = watch().look(frame, time_s), watch().drift
            if not first or membrane is None:
                return report, None
            return report, RigCheck(drift_or_reason(preset, rig, frame), membrane)

        self.job.start(look)

    def _tell(self, found: tuple[WatchReport | None, RigCheck | None]) -> None:
        report, first = found
        result = self._context.result
        messages = self._context.messages
        if first is not None:
            self.first = first
            if first.state == "good":
                messages.show_message(_KEY, Severity.INFO, first.sentence, subject=SOURCE)
            elif isinstance(first.alignment, Drift) and first.alignment.recalibrate:
                self._warn(first.alignment.sentence, ("calibrate",))
            elif first.state == "drifted" and result is not None and result.source.length is not None:
                assert isinstance(first.membrane, MembraneDrift)  # a live source gets more looks, and their report
                self._warn(first.sentence, remedies_of(first.membrane.verdict, result.source.rig))
        if report is None:
            return
        self._context.worker.set_cameras_moved(report.verdict == "camera" and report.state == "told")
        if report.state == "withdrawn":
            messages.clear(_KEY)
        else:
            self._warn(report.sentence, report.remedies)

    def _warn(self, sentence: str, remedies: tuple[str, ...]) -> None:
        mends: dict[str, Offer] = {
            "calibrate": ("Calibrate…", self._calibrate),
            "capture": ("Capture untouched frame…", self._capture),
        }
        offers = [("Show…", self.open), *(mends[remedy] for remedy in remedies)]
        self._context.messages.show_message(_KEY, Severity.WARNING, sentence, offers)

    def _fail(self, sentence: str) -> None:
        self._failed = True  # the same untouched frame would fail again
        if sentence:
            self._context.messages.show_message(_KEY, Severity.INFO, f"Drift is not watched: {sentence}")


class DriftWindow(QDialog):
    """Checks the frame on the screen and shows the drift in pixels and millimetres, and what mends it."""

    def __init__(self, context: Context, calibrate: Callable[[], None], capture: Callable[[], None]) -> None:
        super().__init__(context.window)
        self.setWindowTitle("Check for drift")
        self._context = context
        self.found: RigCheck | None = None
        self._job = Job(self, done=self._show, failed=lambda sentence: self.sentence.setText(as_sentence(sentence)))
        self.sentence, self.unchecked = wrapped_label(_CHECKING, verdict=True), wrapped_label()
        self.sentence.setMinimumHeight(3 * self.sentence.fontMetrics().lineSpacing())
        title = f"Tactile camera: offset of each point from where the calibration expects it, ×{ARROW_FACTOR:.0f}"
        self.image = PointImage(title, magnifies=False)
        self.again = push_button("Check &again", "Check on the newest frame (Ctrl+R)", "Ctrl+R")
        self.calibrate = push_button("Ca&librate…", "Open the calibration wizard")
        self.capture = push_button(
            "Capture &untouched frame…", "Average frames of the membrane while nothing touches it"
        )
        leave = push_button("&Close", "Close this window (Esc)")
        row = hbox(STRETCH, self.again, self.calibrate, self.capture, leave)
        vbox(self.sentence, self.unchecked, (self.image, 1), row, within=self)
        self.resize(760, 720)
        self.again.clicked.connect(self.check)
        self.calibrate.clicked.connect(calibrate)
        self.capture.clicked.connect(capture)
        for asked in (leave.clicked, self.image.cancelRequested):
            asked.connect(self.close)

    def check(self) -> None:
        """Check the newest frame, on another thread."""
        document, result = self._context.document, self._context.result
        if result is None:
            self.sentence.setText(_NO_FRAME)
            return
        preset, home, rig = document.preset, document.untouched_home, result.source.rig
        frame = replace(result.frame, sequence=result.frame_number)  # errors name frames by their numbers
        self.sentence.setText(_CHECKING)
        self.unchecked.clear()
        self.calibrate.setVisible(rig.has_proximity)
        self.image.layer.set_marks([])
        self.image.set_image(picture(frame, rig, "tactile", "color").pixels)
        self._job.start(lambda _: check_rig(preset, home, rig, frame))

    def closeEvent(self, event: QCloseEvent | None) -> None:
        self._job.stop()
        super().closeEvent(event)

    def _show(self, found: RigCheck) -> None:
        self.found = found
        self.sentence.setText(as_sentence(found.sentence))
        self.unchecked.setText("" if found.state == "unknown" else " ".join(map(as_sentence, found.unchecked)))
        if isinstance(drift := found.alignment, Drift):  # else none are shown, since the check began
            moved = zip(drift.tactile.tolist(), drift.offsets_px.tolist(), strict=True)
            marks = [Mark(str(number), u, v, arrow=(du, dv)) for number, ((u, v), (du, dv)) in enumerate(moved)]
            self.image.layer.set_marks(marks)
