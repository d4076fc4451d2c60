"""Choosing the two cameras: what is connected, and which of them is which."""

from __future__ import annotations

from PyQt6.QtCore import Qt, pyqtSignal
from PyQt6.QtWidgets import (
    QComboBox,
    QDialog,
    QDialogButtonBox,
    QFormLayout,
    QHeaderView,
    QLabel,
    QPushButton,
    QTreeWidget,
    QTreeWidgetItem,
    QVBoxLayout,
    QWidget,
)

from ...core.preset import CamerasSection
from .search import CameraSearch, FoundCamera, sentence_of

_SEARCHING = "Looking for cameras…"
_NONE = (
    "No RealSense camera was found. Plug both cameras into USB 3 ports and press Refresh. If they are plugged in, "
    "run “tactune doctor” in a terminal: it says what is missing and how to mend it."
)
_ONE = "Only one camera was found, but contact takes two. Plug the other one in and press Refresh."
_SAME = "Both are the same camera: choose another one for one of them."
_ANY = "by its model"
_PROBLEM_COLUMN = 4


class CameraChooser(QDialog):
    """Lists the connected cameras and asks which is the proximity and which the tactile one.

    Signals
    -------
    chosen(proximity: str, tactile: str)
        Serial numbers; empty: the only connected camera of a fitting model.
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
        self.refresh = QPushButton("&Refresh")
        self.refresh.setToolTip("Look for cameras again (F5)")
        self.refresh.setShortcut("F5")
        self.refresh.setAutoDefault(False)
        self.buttons = QDialogButtonBox(QDialogButtonBox.StandardButton.Open | QDialogButtonBox.StandardButton.Cancel)
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
        """Offer all cameras; choose the one that was chosen before, else one of the fitting kind."""
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
        """Say what is wrong with the choice; only a good one can be opened."""
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
