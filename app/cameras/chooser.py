"""Choosing the two cameras: the search for connected devices in a process of its own, and the dialog."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

from PyQt6.QtCore import QObject, QProcess, Qt, QTimer, pyqtSignal
from PyQt6.QtWidgets import (
    QComboBox,
    QDialog,
    QDialogButtonBox,
    QFormLayout,
    QHeaderView,
    QLabel,
    QTreeWidget,
    QTreeWidgetItem,
    QVBoxLayout,
    QWidget,
)

from ...core.preset import CamerasSection
from ...widgets.basics.controls import dialog_buttons, push_button

#: Time limit of the search, ms. Loading the driver takes a second or two; it may hang.
PATIENCE_MS = 15_000
_PROGRAM = ("-P", "-m", "tactune.app.cameras.list_devices")
_DOCTOR = "run “tactune doctor” in a terminal to find the cause and its remedy"


@dataclass(frozen=True)
class FoundCamera:
    """A connected camera; fields that it does not report are empty."""

    model: str
    serial: str
    firmware: str = ""
    usb: str = ""
    problem: str = ""
    role: str = ""

    @property
    def sees_proximity(self) -> bool:
        """Whether it can look through the membrane (time of flight)."""
        return self.role == "proximity"


class CameraSearch(QObject):
    """Searches for cameras, one search at a time.

    Parameters
    ----------
    arguments : sequence of str
        Arguments of the Python interpreter; the program prints the JSON of `list_devices`.

    Signals
    -------
    found(cameras: list[FoundCamera], hint: str)
        The hint says why a camera may be missing.
    failed(sentence: str)
    """

    found = pyqtSignal(object, str)
    failed = pyqtSignal(str)

    def __init__(self, parent: QObject | None = None, arguments: Sequence[str] = _PROGRAM) -> None:
        super().__init__(parent)
        self._arguments = list(arguments)
        self._process = QProcess(self)
        self._process.finished.connect(self._finished)
        self._process.errorOccurred.connect(self._error_occurred)
        self._patience = QTimer(self)
        self._patience.setSingleShot(True)
        self._patience.setInterval(PATIENCE_MS)
        self._patience.timeout.connect(self._give_up)
        self._answered = False

    @property
    def running(self) -> bool:
        """Whether a search is running."""
        return self._process.state() != QProcess.ProcessState.NotRunning

    def start(self) -> None:
        """Search for cameras, unless a search is running."""
        if not self.running:
            self._answered = False
            self._process.start(sys.executable, self._arguments)
            self._patience.start()

    def stop(self) -> None:
        """Cancel the search."""
        self._answered = True
        self._patience.stop()
        if self.running:
            self._process.kill()
            self._process.waitForFinished(500)

    def _give_up(self) -> None:
        self._fail(f"The camera driver does not answer: unplug the cameras and plug them in again, or {_DOCTOR}.")
        self._process.kill()

    def _error_occurred(self, error: QProcess.ProcessError) -> None:
        if error == QProcess.ProcessError.FailedToStart:
            self._fail(f"The search for cameras cannot be started: {self._process.errorString()}.")

    def _finished(self, status: int, how: QProcess.ExitStatus) -> None:
        self._patience.stop()
        output = bytes(self._process.readAllStandardOutput().data()).decode(errors="replace")
        complaint = bytes(self._process.readAllStandardError().data()).decode(errors="replace").strip()
        if how == QProcess.ExitStatus.CrashExit or status != 0:
            last = complaint.splitlines()[-1] if complaint else f"status {status}"
            self._fail(f"The camera driver failed while searching for cameras ({last}): {_DOCTOR}.")
            return
        try:
            answer = json.loads(output.strip().splitlines()[-1])
            problem = answer.get("problem", "")
            hint = "; ".join(filter(None, [str(answer.get("hint", "")), *answer.get("problems", [])]))
            cameras = [_camera(device) for device in answer.get("devices", [])]
        except (ValueError, IndexError, AttributeError, TypeError):
            self._fail(f"The search for cameras gave no answer: {_DOCTOR}.")
            return
        if problem:
            self._fail(sentence_of(problem))
        elif not self._answered:
            self._answered = True
            self.found.emit(cameras, hint)

    def _fail(self, sentence: str) -> None:
        if not self._answered:
            self._answered = True
            self._patience.stop()
            self.failed.emit(sentence)


def sentence_of(words: str) -> str:
    """Return a text as a sentence, with a capital letter and a full stop."""
    return f"{words[0].upper()}{words[1:].rstrip('.')}."


def _camera(device: dict[str, Any]) -> FoundCamera:
    texts = {field.name: str(device.get(field.name, "") or "") for field in fields(FoundCamera)}
    return FoundCamera(**texts)


_SEARCHING = "Searching for cameras…"
_NONE = (
    "No RealSense camera was found. Plug both cameras into USB 3 ports and press Refresh. If they are plugged in, "
    "run “tactune doctor” in a terminal: it reports what is missing and the remedy."
)
_ONE = "Only one camera was found, but two are needed. Plug in the other one and press Refresh."
_SAME = "The same camera is chosen twice: choose another one for one role."
_ANY = "by its model"
_PROBLEM_COLUMN = 4


class CameraChooser(QDialog):
    """Lists the connected cameras and asks which is the proximity and which the tactile one.

    Signals
    -------
    chosen(proximity: str, tactile: str)
        Serial numbers; empty for the only connected camera of a suitable model.
    """

    chosen = pyqtSignal(str, str)

    def __init__(self, cameras: CamerasSection, search: CameraSearch, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Connect cameras")
        self._search = search
        search.setParent(self)
        self._remembered = (cameras.proximity.serial, cameras.tactile.serial)
        self._found: list[FoundCamera] = []
        self._hint = ""
        self.note = QLabel()
        self.note.setWordWrap(True)
        self.note.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.list = QTreeWidget()
        self.list.setHeaderLabels(["Model", "Serial number", "Firmware", "USB", "Note"])
        self.list.setRootIsDecorated(False)
        self.list.setAccessibleName("Connected cameras")
        self.list.setToolTip("The cameras that are connected now")
        header = self.list.header()
        if header is not None:
            header.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        self.proximity = _combo("Looks through the membrane at the object: the L515 (infrared, time of flight)")
        self.tactile = _combo("Sees the membrane itself: the D405 (visible light, stereo)")
        self.refresh = push_button("&Refresh", "Search for cameras again (F5)", shortcut="F5")
        self.buttons = dialog_buttons(QDialogButtonBox.StandardButton.Open | QDialogButtonBox.StandardButton.Cancel)
        self.buttons.addButton(self.refresh, QDialogButtonBox.ButtonRole.ActionRole)
        self._lay_out()
        self.refresh.clicked.connect(self._look)
        self.proximity.currentIndexChanged.connect(self._check)
        self.tactile.currentIndexChanged.connect(self._check)
        self.buttons.accepted.connect(self._accepted)
        self.buttons.rejected.connect(self.reject)
        self.finished.connect(lambda _: search.stop())
        search.found.connect(self._show_found)
        search.failed.connect(self._show_failure)
        self._look()

    def _lay_out(self) -> None:
        form = QFormLayout()
        form.addRow("&Proximity camera", self.proximity)
        form.addRow("&Tactile camera", self.tactile)
        layout = QVBoxLayout(self)
        layout.addWidget(self.list, 1)
        layout.addWidget(self.note)
        layout.addLayout(form)
        layout.addWidget(self.buttons)
        self.resize(520, 330)

    def _look(self) -> None:
        self.note.setText(_SEARCHING)
        self.refresh.setEnabled(False)
        self._allow(False)
        self._search.start()

    def _show_found(self, cameras: list[FoundCamera], hint: str = "") -> None:
        self._found = [camera for camera in cameras if camera.serial]
        self._hint = hint if not any(camera.sees_proximity for camera in cameras) else ""
        self.refresh.setEnabled(True)
        self.list.clear()
        for camera in cameras:
            usb = f"USB {camera.usb}" if camera.usb and not camera.usb.upper().startswith("USB") else camera.usb
            item = QTreeWidgetItem([camera.model, camera.serial, camera.firmware, usb, camera.problem])
            item.setToolTip(_PROBLEM_COLUMN, camera.problem)
            self.list.addTopLevelItem(item)
        for combo, remembered, through in (
            (self.proximity, self._remembered[0], True),
            (self.tactile, self._remembered[1], False),
        ):
            self._fill(combo, remembered, through)
        self._check()

    def _fill(self, combo: QComboBox, remembered: str, through: bool) -> None:
        """Offer all cameras. Select the one chosen before, else one of a suitable kind."""
        blocked = combo.blockSignals(True)
        combo.clear()
        combo.addItem(_ANY, "")
        for camera in self._found:
            combo.addItem(f"{camera.model} (serial {camera.serial})", camera.serial)
        fitting = next((camera.serial for camera in self._found if camera.sees_proximity == through), "")
        known = combo.findData(remembered) if remembered else -1
        combo.setCurrentIndex(known if known >= 0 else combo.findData(fitting))
        combo.blockSignals(blocked)

    def _show_failure(self, sentence: str) -> None:
        self._show_found([])
        self.note.setText(sentence)

    def _check(self) -> None:
        """Show what is wrong with the choice; only a valid one can be opened."""
        first, second = self.proximity.currentData(), self.tactile.currentData()
        problem = ""
        if not self._found:
            problem = _NONE
        elif len(self._found) == 1:
            problem = _ONE
        elif first and first == second:
            problem = _SAME
        said = problem or f"{len(self._found)} cameras were found."
        self.note.setText(f"{said} {sentence_of(self._hint)}" if self._hint else said)
        self._allow(not problem)

    def _allow(self, allowed: bool) -> None:
        button = self.buttons.button(QDialogButtonBox.StandardButton.Open)
        if button is not None:
            button.setEnabled(allowed)

    def _accepted(self) -> None:
        self.accept()
        self.chosen.emit(self.proximity.currentData() or "", self.tactile.currentData() or "")


def _combo(tip: str) -> QComboBox:
    combo = QComboBox()
    combo.addItem(_ANY, "")
    combo.setToolTip(tip)
    return combo
