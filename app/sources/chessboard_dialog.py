"""A lens from a folder of pictures of a chessboard."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from PyQt6.QtCore import pyqtSignal
from PyQt6.QtWidgets import (
    QDialog,
    QDialogButtonBox,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QSpinBox,
    QWidget,
)

from ...core.calibration.lens import LensFit, fit_lens
from ...core.model.files import user_path
from ...widgets.basics.controls import NoteLabel, ProgressBar, caption, dialog_buttons, push_button
from ...widgets.basics.dialogs import Dialogs
from ...widgets.basics.layouts import vbox
from ..worker.jobs import Job


class ChessboardDialog(QDialog):
    """Asks for the folder and the board, fits a lens on a thread, and says how well it fits.

    Signals
    -------
    chosen(fit: LensFit)
    """

    chosen = pyqtSignal(object)

    def __init__(self, size: tuple[int, int], native_dialogs: bool, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Lens from a chessboard")
        self._size = size
        self._fit: LensFit | None = None
        self._job = Job(self)
        self._dialogs = Dialogs(self, native_dialogs)
        self.folder = QLineEdit()
        self.folder.setAccessibleName("Folder of pictures")
        self.folder.setToolTip(f"Pictures by this camera, {size[0]} x {size[1]} pixels, the board whole and tilted")
        browse = push_button("&Browse…", "Choose the folder")
        self.columns, self.rows = _corners("across", 9), _corners("down", 6)
        self.fit = push_button("&Fit", "Find the board in every picture and fit the lens")
        self.progress = ProgressBar()
        self.progress.hide()
        self.note = NoteLabel("At least 4 pictures of a flat chessboard, tilted in different directions.")
        self.buttons = dialog_buttons(QDialogButtonBox.StandardButton.Ok | QDialogButtonBox.StandardButton.Cancel)
        use = self.buttons.button(QDialogButtonBox.StandardButton.Ok)
        assert use is not None
        use.setText("&Use this lens")
        use.setDefault(True)
        self._use = use
        self._use.setEnabled(False)
        path, board = QHBoxLayout(), QHBoxLayout()
        path.addWidget(self.folder, 1)
        path.addWidget(browse)
        board.addWidget(self.columns)
        board.addWidget(QLabel("x"))
        board.addWidget(self.rows)
        board.addStretch(1)
        form = QFormLayout()
        form.addRow(caption("Fol&der", self.folder), path)
        form.addRow("Inner corners", board)
        vbox(form, self.fit, self.progress, (self.note, 1), self.buttons, within=self)
        self.resize(460, 240)
        browse.clicked.connect(lambda: self._dialogs.open_folder("Pictures", Path.home(), self._browsed))
        self.fit.clicked.connect(self._start)
        self.folder.returnPressed.connect(self._start)
        self._job.progress.connect(self.progress.show_share)
        self._job.busyChanged.connect(self._show_busy)
        self._job.done.connect(self._show_fit)
        self._job.failed.connect(lambda sentence: self.note.say(sentence, error=True))
        self.buttons.accepted.connect(self._accepted)
        self.buttons.rejected.connect(self.reject)
        self.finished.connect(self._job.stop)

    def _browsed(self, path: Path) -> None:
        self.folder.setText(str(path))

    def _start(self) -> None:
        if self._job.busy or not self.folder.text().strip():
            return
        self._use.setEnabled(False)
        folder = user_path(self.folder.text().strip())
        self._job.start(partial(fit_lens, folder, self.columns.value(), self.rows.value(), self._size))

    def _show_busy(self, busy: bool) -> None:
        self.progress.setVisible(busy)
        self.fit.setEnabled(not busy)

    def _show_fit(self, fit: LensFit) -> None:
        self._fit = fit
        lens, rejected = fit.intrinsics, ", ".join(fit.refused)
        self.note.say(
            f"{fit.used} of {fit.used + len(fit.refused)} pictures, {fit.rms_px:.2f} px RMS: fx {lens.fx:.1f} ± "
            f"{fit.focal_sd_px:.1f} px, fy {lens.fy:.1f} px, centre {lens.cx:.1f}, {lens.cy:.1f} px."
            + (f" Rejected: {rejected}." if rejected else "")
        )
        self._use.setEnabled(True)
        self._use.setFocus()

    def _accepted(self) -> None:
        fit = self._fit
        self.accept()
        if fit is not None:
            self.chosen.emit(fit)


def _corners(direction: str, value: int) -> QSpinBox:
    box = QSpinBox()
    box.setRange(3, 50)
    box.setValue(value)
    box.setAccessibleName(f"Inner corners {direction}")
    box.setToolTip(f"Inner corners of the board {direction}: one less than its squares")
    return box
