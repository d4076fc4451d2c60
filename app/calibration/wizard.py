"""The window of the calibration wizard, with six steps in any order, and its launcher."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path

from PyQt6.QtCore import QObject, Qt, pyqtSignal
from PyQt6.QtGui import QCloseEvent, QKeyEvent, QKeySequence, QShortcut
from PyQt6.QtWidgets import QButtonGroup, QDialog, QFileDialog, QHBoxLayout, QStackedWidget, QVBoxLayout, QWidget

from ...core.calibration import CalibrationReport, Correspondence, read_points, write_points
from ...core.calibration.recheck import Replacement, replacement
from ...core.calibration.report import grade
from ...core.errors import TactuneError
from ...widgets.basics.controls import AccentButton, ElidedLabel, push_button
from ...widgets.basics.dialogs import Dialogs, bring_up
from ...widgets.basics.message_bar import MessageBar, Severity
from ...widgets.clouds.cloud_view import BackendChoice
from ..context import Context
from ..document.document import Document
from ..worker.feed import FrameFeed, WorkerFeed
from .check_page import CheckPage
from .fitting import MIN_PAIRS, Fitter, Outcome, at_least, correspondences, pairs_of
from .frames_page import FramesPage
from .helpers_page import HelpersPage
from .keeping import Keeper, preset_values
from .model_page import ModelPage
from .pictures import snap, tactile_depth_at
from .points_page import PointsPage
from .quality_page import QualityPage
from .recheck_window import RecheckWindow
from .session import ProximityImage, Session, SessionState, count_pairs
from .snapshots import Collector

STEPS = ("Frames", "Points", "Helpers", "Model", "Quality", "Check")
_TIPS = (
    "Take snapshots of the membrane, at one or several inflation levels",
    "Click the same spots in both images",
    "Find points automatically on boards, dot grids or the membrane's texture",
    "Compare both models and choose one",
    "Quality of the calibration and the next step",
    "Compare images and patch with the new and the old alignment",
)
_NO_PAIRS = f"0 pairs; {MIN_PAIRS} are needed for a first fit."
_FILTERS = "Points (*.csv *.points);;All files (*)"


class CalibrationWizard(QDialog):
    """Leads from frames to a saved alignment. Closing it loses nothing.

    Parameters
    ----------
    feed : FrameFeed
        The current source.
    document : Document
        The preset that the alignment is saved into, as one undoable step.
    folder : Path
        Where the state is saved when the wizard is closed.
    native_dialogs : bool
        Use the operating system's file dialogs.
    backend : "auto", "opengl" or "software"
        Of the 3D views.

    Signals
    -------
    saved()
        The alignment is in the document.
    fileSaveRequested()
        The document is to be saved to its file.
    """

    saved = pyqtSignal()
    fileSaveRequested = pyqtSignal()

    def __init__(
        self,
        feed: FrameFeed,
        document: Document,
        folder: Path,
        native_dialogs: bool = True,
        backend: BackendChoice = "auto",
        parent: QWidget | None = None,
    ) -> None:
        super().__init__(parent)
        self.setWindowTitle("Calibrate – Tactune")
        self.setWindowFlag(Qt.WindowType.WindowMaximizeButtonHint)
        self._feed, self._document, self._native = feed, document, native_dialogs
        self._dialogs = Dialogs(self, native_dialogs)
        self.outcome = Outcome()
        self._saved = False
        rig = feed.rig
        self.session = Session(rig, lambda snapshot, u, v: tactile_depth_at(snapshot.frame, rig, u, v), self)
        self.keeper = Keeper(self.session, folder, self)
        self.fitter = Fitter(self.session, self)
        self.collector = Collector(feed, self)
        self.messages = MessageBar()
        self.frames = FramesPage(self.session, feed, self.collector)
        self.points = PointsPage(self.session, snap)
        self.helpers = HelpersPage(self.session)
        self.model = ModelPage(self.session)
        self.quality = QualityPage(self.session)
        self.check = CheckPage(self.session, document, feed, backend)
        self.pages: tuple[QWidget, ...] = (
            self.frames, self.points, self.helpers, self.model, self.quality, self.check,
        )  # fmt: skip
        self._lay_out()
        self._connect()
        self.resize(1240, 760)
        self._offer(self.keeper.restore())
        self._offer_stored()
        self._show_state(self.session.state)
        self._allow_saving(_NO_PAIRS)
        self.go_to(1 if self.session.state.snapshots and not self._elsewhere() else 0)

    # Building

    def _lay_out(self) -> None:
        steps = QHBoxLayout()
        steps.setSpacing(2)
        self.steps = QButtonGroup(self)
        for number, (name, tip) in enumerate(zip(STEPS, _TIPS, strict=True)):
            button = AccentButton(f"{number + 1}  {name}", f"{tip} (Ctrl+{number + 1})")
            button.setMinimumHeight(30)
            button.setMinimumWidth(120)
            self.steps.addButton(button, number)
            steps.addWidget(button)
        steps.addStretch(1)
        self.stack = QStackedWidget()
        for page in self.pages:
            self.stack.addWidget(page)
        self.verdict = ElidedLabel()
        self.over = push_button("Start over", "Clear the wizard, after a question; undo restores everything")
        self.undo = push_button("Undo", "")
        self.redo = push_button("Redo", "")
        self.back = push_button("Back", "To the step before (Ctrl+Page Up)")
        self.next = push_button("Next", "To the next step (Ctrl+Page Down)")
        self.save = push_button("Save into preset", "")
        self.leave = push_button("Close", "Close the wizard; everything is saved and restored next time")
        footer = QHBoxLayout()
        for push in (self.over, self.undo, self.redo):
            footer.addWidget(push)
        footer.addWidget(self.verdict, 1)
        for push in (self.back, self.next, self.save, self.leave):
            footer.addWidget(push)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(6, 6, 6, 6)
        layout.setSpacing(4)
        layout.addLayout(steps)
        layout.addWidget(self.messages)
        layout.addWidget(self.stack, 1)
        layout.addLayout(footer)

    def _connect(self) -> None:
        session, stack = self.session, self.session.undo_stack
        self.steps.idClicked.connect(self.go_to)
        self.back.clicked.connect(lambda: self.go_to(self.stack.currentIndex() - 1))
        self.next.clicked.connect(lambda: self.go_to(self.stack.currentIndex() + 1))
        self.over.clicked.connect(self.ask_start_over)
        for push, name, keys, changed, can in (
            (self.undo, "Undo", "Ctrl+Z", stack.undoTextChanged, stack.canUndoChanged),
            (self.redo, "Redo", "Ctrl+Shift+Z", stack.redoTextChanged, stack.canRedoChanged),
        ):
            changed.connect(lambda text, push=push, name=name, keys=keys: push.setToolTip(f"{name}: {text} ({keys})"))
            can.connect(push.setEnabled)
            push.setEnabled(False)
        self.undo.clicked.connect(stack.undo)
        self.redo.clicked.connect(stack.redo)
        self.save.clicked.connect(self.save_into_preset)
        self.leave.clicked.connect(self.close)
        self.points.importRequested.connect(self._import_dialog)
        self.points.exportRequested.connect(self._export_dialog)
        self.keeper.failed.connect(lambda words: self.messages.show_message("keeping", Severity.WARNING, words))
        self.helpers.accepted.connect(self._accepted)
        self.fitter.fitted.connect(self._show_outcome)
        self._document.refused.connect(self._refused)
        self._document.fileChanged.connect(self._file_changed)
        session.changed.connect(self._show_state)
        shortcuts: tuple[tuple[str, Callable[[], object]], ...] = (
            ("Ctrl+PgUp", lambda: self.go_to(self.stack.currentIndex() - 1)),
            ("Ctrl+PgDown", lambda: self.go_to(self.stack.currentIndex() + 1)),
            ("Ctrl+Z", stack.undo),
            ("Ctrl+Shift+Z", stack.redo),
            ("Ctrl+Y", stack.redo),
            ("Ctrl+S", self.save_into_preset),
            *((f"Ctrl+{number + 1}", partial(self.go_to, number)) for number in range(len(STEPS))),
        )
        for keys, action in shortcuts:
            QShortcut(QKeySequence(keys), self).activated.connect(action)

    # Steps

    def go_to(self, number: int) -> None:
        """Show a step. Leaving the page Helpers accepts its proposals, so that nothing found is lost."""
        number = max(0, min(number, len(STEPS) - 1))
        if number != self.stack.currentIndex():
            self.messages.clear("accepted")
        if self.pages[number] is not self.helpers:
            self.helpers.accept_proposals()
        self.stack.setCurrentIndex(number)
        button = self.steps.button(number)
        assert button is not None
        button.setChecked(True)
        self.pages[number].setFocus()
        self.back.setEnabled(number > 0)
        self.next.setEnabled(number < len(STEPS) - 1)

    def ask_start_over(self) -> None:
        """Clear the session after a question."""
        self._dialogs.ask(
            "Start over",
            f"Clear {_contents(self.session.state)}?",
            "Undo restores them until the wizard is closed.",
            "Clear",
            self.start_over,
        )

    def start_over(self) -> None:
        """Clear the session, as one undoable step."""
        kept_choices = SessionState().with_choices(average=self.session.state.choices.average)
        self.session.edit("Start over", kept_choices)
        for key in ("kept", "accepted"):
            self.messages.clear(key)
        self.go_to(0)

    def _elsewhere(self) -> bool:
        """Tell whether the snapshots are all of other sources than the open one."""
        sources = self.session.state.sources
        return bool(sources) and self._feed.info.name not in sources

    def _offer(self, kept_at: datetime | None) -> None:
        if kept_at is None:
            return
        state = self.session.state
        of = f" of {', '.join(state.sources)}" if state.sources else ""
        words = f"Restored the calibration{of} from {kept_at.astimezone():%d %B, %H:%M}: {_contents(state)}. "
        if self._elsewhere():
            words += (
                f"{self._feed.info.name} is open now, and its membrane may be another one. Take new snapshots, "
                "continue with the old ones, or start over."
            )
        else:
            words += "Continue, or start over."
        self.messages.show_message(
            "kept",
            Severity.WARNING if self._elsewhere() else Severity.INFO,
            words,
            offers=[("Start over", self.ask_start_over)],
        )

    def _accepted(self, keys: tuple[int, ...]) -> None:
        self.messages.show_message(
            "accepted",
            Severity.INFO,
            f"{count_pairs(len(keys))} found on the page Helpers {'was' if len(keys) == 1 else 'were'} added.",
            offers=[("Remove again", lambda: self.session.remove(keys))],
        )

    def _offer_stored(self) -> None:
        """Offer the points stored in the preset, if there are no newer ones."""
        record = self._document.preset.alignment.calibration
        if record is None or not record.points or not self.session.state.empty:
            return
        stored = [Correspondence(**point.model_dump()) for point in record.points]
        pairs = pairs_of(stored, self.session.state, self.session.rig, origin="preset")
        self.messages.show_message(
            "stored",
            Severity.INFO,
            f"The preset contains {len(pairs)} pairs of {record.date.astimezone():%d %B %Y}. They are valid if "
            "nothing has moved since.",
            offers=[("Use them", lambda: self.session.add_pairs(pairs, "Take the preset's pairs"))],
        )

    def _show_state(self, state: SessionState) -> None:
        self.over.setEnabled(not state.empty)

    def _allow_saving(self, missing: str) -> None:
        """Enable saving, or say what is missing."""
        self.save.setEnabled(not missing)
        self.save.setToolTip(
            f"Nothing to save yet: {missing}"
            if missing
            else "Put the alignment into the preset, with its points and quality (Ctrl+S)"
        )

    def _show_outcome(self, outcome: Outcome) -> None:
        self.outcome = outcome
        report = outcome.report
        self._allow_saving("" if report is not None else outcome.sentence)
        self.verdict.setText(outcome.sentence if report is None else _short(report))
        self.verdict.setToolTip(outcome.sentence if report is None else report.verdict)
        for page in (self.points, self.helpers, self.model, self.quality, self.check):
            page.show_outcome(outcome)

    # Files

    def import_points(self, path: Path) -> None:
        """Add the pairs of a file, as one step."""
        try:
            points = read_points(path)
        except TactuneError as error:
            self.messages.show_message("file", Severity.ERROR, str(error))
            return
        state = self.session.state
        if path.suffix == ".points":  # the file names no images, so the current ones are meant
            image: ProximityImage = "color" if state.choices.proximity_image == "color" else "depth"
            number = None if state.snapshot is None else state.snapshots.index(state.snapshot)
            points = [replace(point, proximity_image=image, snapshot=number) for point in points]
        pairs = pairs_of(points, state, self.session.rig, origin=path.name)
        self.session.add_pairs(pairs, f"Import {len(pairs)} pairs")
        self.messages.show_message("file", Severity.INFO, f"{len(pairs)} pairs were read from {path}.")

    def export_points(self, path: Path) -> None:
        """Write the complete pairs to a file."""
        try:
            write_points(path, correspondences(self.session.state, self.session.rig))
        except TactuneError as error:
            self.messages.show_message("file", Severity.ERROR, str(error))
            return
        self.messages.show_message("file", Severity.INFO, f"The pairs were written to {path}.")

    def _import_dialog(self) -> None:
        path, _ = QFileDialog.getOpenFileName(self, "Import points", "", _FILTERS, options=self._options())
        if path:
            self.import_points(Path(path))

    def _export_dialog(self) -> None:
        path, _ = QFileDialog.getSaveFileName(self, "Export points", "points.csv", _FILTERS, options=self._options())
        if path:
            self.export_points(Path(path))

    def _options(self) -> QFileDialog.Option:
        return QFileDialog.Option(0) if self._native else QFileDialog.Option.DontUseNativeDialog

    def save_into_preset(self) -> None:
        """Save the alignment in the document; ask first if it is worse than the present one."""
        report = self.outcome.report
        if report is None:
            return
        errors = replacement(report, self._document.preset)
        if errors is not None and errors.worse:
            self._dialogs.ask(
                "Replace the alignment",
                "The new calibration is worse than the present alignment.",
                f"{_both_errors(errors)}. Click the pairs with the largest residuals again, or add pairs.",
                "Replace anyway",
                partial(self._save, report),
            )
        else:
            self._save(report)

    def _save(self, report: CalibrationReport) -> None:
        """Save the alignment and its record in the document, as one undoable step."""
        set_tolerance = self.check.set_tolerance.isChecked()
        values = preset_values(report, self._document.preset, self.session.state, set_tolerance)
        self.check.keep_present()
        if self._document.edit_many(values):
            self._saved = True
            self._offer_file()
            self.saved.emit()

    def _offer_file(self) -> None:
        self.messages.show_message(
            "saved",
            Severity.WARNING,
            "The alignment is in the preset, but the preset's file is not saved yet. Undo in the main window removes "
            "the alignment.",
            offers=[("Save preset", self._save_file)],
        )

    def _save_file(self) -> None:
        self.fileSaveRequested.emit()
        if self._document.dirty:  # a new preset needs a file name first
            self._offer_file()

    def _file_changed(self) -> None:
        """Say that the alignment is in the file now."""
        if self._saved and not self._document.dirty:
            self._saved = False
            self.messages.show_message("saved", Severity.INFO, f"The preset was saved in {self._document.path}.")

    def _refused(self, _: str, words: str) -> None:
        if self.isVisible():
            self.messages.show_message("saved", Severity.ERROR, words)

    # Events

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        """Pass Escape and Enter to the pages: neither closes the wizard."""
        if event is not None and event.key() in {Qt.Key.Key_Escape, Qt.Key.Key_Return, Qt.Key.Key_Enter}:
            event.accept()
            return
        super().keyPressEvent(event)

    def closeEvent(self, event: QCloseEvent | None) -> None:
        """Save the state and cancel running jobs."""
        self.collector.close()
        self.fitter.close()
        for page in (self.helpers, self.quality, self.check):
            page.close_jobs()
        self.keeper.close()
        self.session.close()
        super().closeEvent(event)


def _contents(state: SessionState) -> str:
    """Return what a session holds, in words."""
    snapshots = "1 snapshot" if len(state.snapshots) == 1 else f"{len(state.snapshots)} snapshots"
    return f"{count_pairs(len(state.pairs))} and {snapshots}"


def _short(report: CalibrationReport) -> str:
    """Return the verdict in one line: grade, error, next step."""
    judged, quality = grade(report.chosen), report.chosen
    word, next_step = judged.partition(":")[0], report.verdict.removeprefix(judged).strip()
    errors = f"{at_least(quality.alignment_px, 'px')}, {at_least(quality.alignment_mm, 'mm')}"
    return f"{word}, {report.model}: {errors}. {next_step}"


def _both_errors(errors: Replacement) -> str:
    """Return the errors of both alignments in words."""
    return (
        f"Expected alignment error: {at_least(errors.new_px, 'px')} new, {at_least(errors.present_px, 'px')} present, "
        "judged by the pairs"
    )


_NO_FRAME = "There is no frame to calibrate on yet: open a source first."


class CalibrationLauncher(QObject):
    """Opens at most one wizard and one re-check window, and passes frames to them."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._context = context
        self._feed: WorkerFeed | None = None
        self.wizard: CalibrationWizard | None = None
        self.recheck: RecheckWindow | None = None
        context.frameShown.connect(self._frame_shown)

    def open_wizard(self) -> None:
        """Open the wizard on the current source, or bring it to the front."""
        context = self._context
        if context.result is None:
            context.messages.show_message("calibration", Severity.WARNING, _NO_FRAME)
            return
        if self.wizard is None:
            self._feed = WorkerFeed(context.worker, context.result, context.playback, self)
            self.wizard = CalibrationWizard(
                self._feed,
                context.document,
                context.data_folder / "calibration",
                context.dialogs.native,
                context.cloud_backend,
                context.window,
            )
            self.wizard.fileSaveRequested.connect(context.saveRequested)
            self.wizard.finished.connect(self._wizard_closed)
        bring_up(self.wizard)

    def open_recheck(self) -> None:
        """Check the preset's alignment on the current frame."""
        context = self._context
        if context.result is None:
            context.messages.show_message("calibration", Severity.WARNING, _NO_FRAME)
            return
        if self.recheck is None:
            self.recheck = RecheckWindow(context.window)
            self.recheck.againRequested.connect(self._check)
            self.recheck.calibrateRequested.connect(self.open_wizard)
        self.recheck.show()
        self.recheck.raise_()
        self._check()

    def close(self) -> None:
        """Close both windows; the wizard's state is saved."""
        for opened in (self.wizard, self.recheck):
            if opened is not None:
                opened.close()

    def _frame_shown(self) -> None:
        if self._feed is not None and self._context.result is not None:
            self._feed.show_result(self._context.result)

    def _check(self) -> None:
        document, result = self._context.document, self._context.result
        if self.recheck is not None and result is not None:
            frame = replace(result.frame, sequence=result.frame_number)  # errors name frames by their numbers
            self.recheck.check(document.preset, result.source.rig, frame, document.untouched_home)

    def _wizard_closed(self) -> None:
        if self.wizard is not None:
            self.wizard.deleteLater()
        if self._feed is not None:
            self._feed.deleteLater()
        self.wizard, self._feed = None, None
