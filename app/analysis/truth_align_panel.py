"""The panel for the scan's pose: picked pairs, numbers, and refining by ICP."""

from __future__ import annotations

from collections.abc import Sequence
from math import radians
from typing import Final

import numpy as np
from PyQt6.QtCore import Qt, pyqtSignal
from PyQt6.QtGui import QKeySequence, QShortcut
from PyQt6.QtWidgets import (
    QAbstractItemView,
    QGridLayout,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QProgressBar,
    QPushButton,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
)
from scipy.spatial.transform import Rotation

from ...core.model.arrays import Float64Array
from ...core.model.frames import Matrix4
from ...widgets.basics.collapsible import CollapsibleSection
from ...widgets.parameters.fields import FieldSpec
from ...widgets.parameters.number_entry import NumberEntry
from ...widgets.parameters.parameter_row import MessageLabel
from .truth_state import PickedPair
from .truth_work import Refinement

_AXES: Final = ("x", "y", "z")
_TURNS: Final = ("Roll", "Pitch", "Yaw")
#: So many pairs are seen at once.
_ROWS = 3
_REACH = FieldSpec(
    path="reach",
    title="ICP reach",
    description="Pairs of points farther apart than this are left out of ICP; larger than the error that is left now.",
    kind="number",
    default=0.010,
    unit="m",
    factor=1000.0,
    suffix=" mm",
    minimum=0.0,
    maximum=0.2,
    open_minimum=True,
    slider=(0.001, 0.05),
    step=0.001,
)


def _place_spec(axis: str) -> FieldSpec:
    return FieldSpec(
        path=axis,
        title=axis,
        description=f"Where the middle of the scan's contact lies along {axis} of the proximity camera. "
        "Arrow keys move by 0.1 mm, page keys by 1 mm.",
        kind="number",
        default=0.0,
        unit="m",
        factor=1000.0,
        suffix=" mm",
        minimum=-10.0,
        maximum=10.0,
        slider=(-0.999, 0.999),
        step=0.0001,
    )


def _turn_spec(name: str, axis: str) -> FieldSpec:
    return FieldSpec(
        path=name.lower(),
        title=name,
        description=f"Turn of the scan about {axis} of the proximity camera; roll first, then pitch, then yaw. "
        "In degrees; arrow keys turn by 0.1°, page keys by 1°.",
        kind="number",
        default=0.0,
        suffix="°",
        minimum=-360.0,
        maximum=360.0,
        slider=(-180.0, 180.0),
        step=0.1,
    )


class AlignPanel(CollapsibleSection):
    """Pairs with their residuals, the pose in numbers, and ICP.

    Signals
    -------
    selectionChanged(number: int)
        Another pair is selected, from 0; -1: none.
    removeRequested(number: int), clearRequested()
    layRequested()
    poseEdited(pose: float64 (4, 4), gesture: int)
    refineRequested(reach_m: float), cancelRequested()
    """

    selectionChanged = pyqtSignal(int)
    removeRequested = pyqtSignal(int)
    clearRequested = pyqtSignal()
    layRequested = pyqtSignal()
    poseEdited = pyqtSignal(object, int)
    refineRequested = pyqtSignal(float)
    cancelRequested = pyqtSignal()

    def __init__(self) -> None:
        super().__init__("Alignment")
        self._pose: Float64Array | None = None
        self._pivot = np.zeros(3)
        self.table = QTableWidget(0, 2)
        self.remove = QPushButton("&Delete pair")
        self.clear = QPushButton("Delete all")
        self.lay = QPushButton("&Lay on the patch")
        self.places = [NumberEntry(_place_spec(axis)) for axis in _AXES]
        self.turns = [NumberEntry(_turn_spec(name, axis)) for name, axis in zip(_TURNS, _AXES, strict=True)]
        self.reach = NumberEntry(_REACH)
        self.refine = QPushButton("Re&fine by ICP")
        self.cancel = QPushButton("Cancel")
        self.progress = QProgressBar()
        self.outcome = QLabel()
        self.refusal = MessageLabel()
        self._set_up_table()
        self._lay_out()
        self._connect()
        self.show_pose(None, None)
        self.show_progress(1.0, "")

    def _set_up_table(self) -> None:
        table = self.table
        table.setHorizontalHeaderLabels(["Pair", "Residual"])
        table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        table.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        table.setTabKeyNavigation(False)
        table.setAccessibleName("Pairs of points")
        table.setToolTip("The pairs that were clicked, with what is left between both points, in millimetres")
        rows, columns = table.verticalHeader(), table.horizontalHeader()
        assert rows is not None and columns is not None
        rows.hide()
        rows.setDefaultSectionSize(table.fontMetrics().height() + 6)
        columns.setSectionResizeMode(QHeaderView.ResizeMode.Stretch)
        table.setFixedHeight(columns.sizeHint().height() + _ROWS * rows.defaultSectionSize() + 4)

    def _lay_out(self) -> None:
        self.remove.setToolTip("Delete the selected pair (Del); the rest is fitted again")
        self.clear.setToolTip("Delete all pairs; the scan stays where it is")
        self.lay.setToolTip("Lay the middle of the scan's contact on the patch's, to go on by hand without pairs")
        self.refine.setToolTip("Refine the pose by iterative closest points, from where the scan lies now")
        self.cancel.setToolTip("Leave the scan where it is")
        self.outcome.setWordWrap(True)
        self.progress.setRange(0, 100)
        for entry in (*self.places, *self.turns):
            entry.setMinimumWidth(entry.minimumSizeHint().width())
        buttons = QHBoxLayout()
        for button in (self.remove, self.clear, self.lay):
            button.setAutoDefault(False)
            buttons.addWidget(button)
        numbers = QGridLayout()
        numbers.setHorizontalSpacing(6)
        numbers.setVerticalSpacing(3)
        for line, (place, turn) in enumerate(zip(self.places, self.turns, strict=True)):
            for column, (text, entry) in enumerate(((_AXES[line], place), (_TURNS[line], turn))):
                label = QLabel(text)
                label.setBuddy(entry)
                numbers.addWidget(label, line, 2 * column)
                numbers.addWidget(entry, line, 2 * column + 1)
        numbers.setColumnStretch(1, 1)
        numbers.setColumnStretch(3, 1)
        icp = QHBoxLayout()
        reach = QLabel("Reach")
        reach.setBuddy(self.reach)
        for button in (self.refine, self.cancel):
            button.setAutoDefault(False)
        for widget in (self.refine, reach, self.reach, self.cancel):
            icp.addWidget(widget)
        icp.addStretch(1)
        layout = QVBoxLayout(self.body)
        layout.setContentsMargins(6, 4, 6, 6)
        layout.setSpacing(5)
        layout.addWidget(self.table)
        layout.addLayout(buttons)
        layout.addLayout(numbers)
        layout.addWidget(self.refusal)
        layout.addLayout(icp)
        layout.addWidget(self.progress)
        layout.addWidget(self.outcome)

    def _connect(self) -> None:
        self.table.itemSelectionChanged.connect(self._selected)
        self.remove.clicked.connect(lambda: self.removeRequested.emit(self.selected()))
        delete = QShortcut(QKeySequence(QKeySequence.StandardKey.Delete), self.table)
        delete.setContext(Qt.ShortcutContext.WidgetShortcut)
        delete.activated.connect(self.remove.click)
        self.clear.clicked.connect(self.clearRequested)
        self.lay.clicked.connect(self.layRequested)
        self.refine.clicked.connect(lambda: self.refineRequested.emit(float(self.reach.value())))
        self.cancel.clicked.connect(self.cancelRequested)
        for entry in (*self.places, *self.turns):
            entry.edited.connect(lambda _, gesture: self._edited(gesture))
        for entry in (*self.places, *self.turns, self.reach):
            entry.refused.connect(self.refusal.show_sentence)
            entry.edited.connect(lambda *_: self.refusal.show_sentence(""))
        for entry in (*self.places, *self.turns):
            entry.setValue(0.0)
        self.reach.setValue(_REACH.default)

    def selected(self) -> int:
        """Return the selected pair, from 0; -1: none."""
        rows = {index.row() for index in self.table.selectedIndexes()}
        return min(rows, default=-1)

    def show_pairs(self, pairs: Sequence[PickedPair], residuals_mm: Sequence[float]) -> None:
        """Show the pairs; residuals are those of the complete ones, in their order, or none."""
        chosen = self.selected()
        left = list(residuals_mm)
        self.table.setRowCount(len(pairs))
        for number, pair in enumerate(pairs):
            if pair.complete:
                text = f"{left.pop(0):.2f} mm" if left else "–"
            else:
                text = "click it on the patch" if pair.patch is None else "click it on the scan"
            for column, words in enumerate((str(number + 1), text)):
                item = QTableWidgetItem(words)
                item.setTextAlignment(Qt.AlignmentFlag.AlignCenter)
                self.table.setItem(number, column, item)
        if 0 <= chosen < len(pairs):
            self.table.selectRow(chosen)
        self.clear.setEnabled(bool(pairs))
        self._selected()

    def show_pose(self, pose: Matrix4 | None, pivot: Float64Array | None) -> None:
        """Show a pose and what the scan turns about, in the proximity frame."""
        posed = pose is not None and pivot is not None
        for widget in (*self.places, *self.turns, self.refine, self.reach):
            widget.setEnabled(posed)
        self._pose = None if pose is None else np.asarray(pose)
        if self._pose is None or pivot is None:
            return
        self._pivot = pivot
        for entry, metres in zip(self.places, pivot, strict=True):
            entry.setValue(float(metres))
        # Where the same rotation can be said in other angles (a typed one over 90 degrees, say), they stay.
        shown = _rotation([float(entry.value()) for entry in self.turns])
        if not np.allclose(shown, self._pose[:3, :3], atol=1e-9):
            for entry, degrees in zip(self.turns, _angles(self._pose[:3, :3]), strict=True):
                entry.setValue(degrees)

    def show_progress(self, share: float, words: str) -> None:
        """Show how far ICP is; from 1 on it has ended."""
        busy = share < 1
        self.progress.setVisible(busy)
        self.cancel.setVisible(busy)
        self.refine.setEnabled(not busy and self._pose is not None)
        self.progress.setValue(round(100 * share))
        self.progress.setFormat(words)

    def show_refinement(self, refinement: Refinement | None) -> None:
        """Say what ICP changed."""
        if refinement is None:
            self.outcome.clear()
            return
        found = refinement.found
        more = "" if found.converged else " It has not come to rest yet: refine again."
        self.outcome.setText(
            f"ICP: RMSE {1e3 * refinement.before_m:.2f} mm before, {1e3 * found.rmse_m:.2f} mm after "
            f"{found.iterations} rounds, over {found.pairs:,} pairs of points.{more}"
        )

    def _selected(self) -> None:
        number = self.selected()
        self.remove.setEnabled(number >= 0)
        self.selectionChanged.emit(number)

    def _edited(self, gesture: int) -> None:
        """Take what stands in the entries: the scan turns about the middle of its contact."""
        if self._pose is None:
            return
        after = np.eye(4)
        after[:3, :3] = _rotation([float(entry.value()) for entry in self.turns])
        in_scan = self._pose[:3, :3].T @ (self._pivot - self._pose[:3, 3])
        place = np.array([float(entry.value()) for entry in self.places])
        after[:3, 3] = place - after[:3, :3] @ in_scan
        self.poseEdited.emit(after, gesture)


def _rotation(degrees: Sequence[float]) -> Float64Array:
    """Return the rotation of roll, pitch and yaw: about x, y and z, which stay where they are."""
    return np.asarray(Rotation.from_euler("xyz", degrees, degrees=True).as_matrix())


def _angles(rotation: Float64Array) -> list[float]:
    """Return roll, pitch and yaw in degrees; at a pitch of 90 degrees, where roll is yaw, roll is 0."""
    pitch = np.arcsin(np.clip(-rotation[2, 0], -1.0, 1.0))
    if abs(pitch) > radians(89.9999):
        roll, yaw = 0.0, np.arctan2(-rotation[0, 1], rotation[1, 1])
    else:
        roll, yaw = np.arctan2(rotation[2, 1], rotation[2, 2]), np.arctan2(rotation[1, 0], rotation[0, 0])
    return [float(np.degrees(angle)) for angle in (roll, pitch, yaw)]
