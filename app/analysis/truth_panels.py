"""Panels of the ground-truth tab: paint, alignment and result."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from math import radians
from typing import Any, Final, cast

import numpy as np
from PyQt6.QtCore import Qt, pyqtSignal
from PyQt6.QtGui import QKeySequence, QShortcut
from PyQt6.QtWidgets import (
    QAbstractItemView,
    QCheckBox,
    QGridLayout,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QLineEdit,
    QTableWidget,
    QTableWidgetItem,
)
from scipy.spatial.transform import Rotation

from ...core.errors import minus
from ...core.lab.scan import PaintSettings
from ...core.model.arrays import Float64Array, Uint8Array
from ...core.model.frames import Matrix4
from ...core.preset import MaskSection
from ...widgets.basics.controls import (
    AccentButton,
    CollapsibleSection,
    NoteLabel,
    ProgressBar,
    caption,
    copy_text,
    push_button,
    read_only_table,
    wrapped_label,
)
from ...widgets.basics.fields import FieldSpec, field_spec
from ...widgets.basics.gestures import new_gesture
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from ...widgets.images.eyedropper import Mode, new_ranges
from ...widgets.parameters.editors import NumberEntry
from ...widgets.parameters.form import ParameterRow
from .truth_state import PickedPair
from .truth_work import Refinement, Scores

_CHANNELS: Final = ("hue", "saturation", "value")
_USUAL: Final = PaintSettings()
_MEANINGS: Final = {
    "hue": "Hue range of the touched paint, 0 to 179 as in OpenCV; wraps around if the lower end is larger.",
    "saturation": "Saturation range of the touched paint, 0 grey to 255 pure.",
    "value": "Brightness range of the touched paint, 0 black to 255 brightest.",
}
_MIN_AREA = FieldSpec(
    path="least_area_mm2",
    title="Least area",
    description="Smaller spots of paint are removed, and smaller holes are filled.",
    kind="number",
    default=_USUAL.least_area_mm2,
    unit="mm2",
    suffix=" mm²",
    maximum=100_000.0,
    slider=(0.0, 500.0),
    step=1.0,
)
_LARGEST = FieldSpec(
    path="largest",
    title="Spots kept",
    description="Number of spots to keep, the largest first; 0 keeps all.",
    kind="number",
    default=_USUAL.largest,
    maximum=1000.0,
    slider=(0.0, 20.0),
    integer=True,
)
_DROPPERS: Final[dict[Mode, tuple[str, str]]] = {
    "set": ("&Pick", "Click the touched paint on the scan to set the range to its colour; press again to stop"),
    "expand": ("+", "Click touched paint that is missing to extend the range by its colour"),
    "shrink": ("−", "Click other paint to exclude its colour from the range"),
}


class PaintPanel(CollapsibleSection):
    """Colour range with eyedroppers, clean-up, and the resulting contact.

    Signals
    -------
    edited(paint: PaintSettings, gesture: int)
    eyedropperChanged(mode: str)
        "set", "expand", "shrink" or "off".
    """

    edited = pyqtSignal(object, int)
    eyedropperChanged = pyqtSignal(str)

    def __init__(self) -> None:
        super().__init__("Paint")
        self._paint = PaintSettings()
        specs = [
            replace(field_spec(MaskSection, name), description=_MEANINGS[name], default=getattr(_USUAL, name))
            for name in _CHANNELS
        ]
        self.rows = {spec.path: ParameterRow(spec, self) for spec in (*specs, _MIN_AREA, _LARGEST)}
        self.droppers = {mode: AccentButton(text, tip) for mode, (text, tip) in _DROPPERS.items()}
        self.highlight = QCheckBox("&Highlight contact")
        self.highlight.setChecked(True)
        self.highlight.setToolTip("Show contact in its own colour; off shows the paint")
        self.readout = wrapped_label()
        self._lay_out()
        for row in self.rows.values():
            row.edited.connect(self._row_edited)
        for mode, button in self.droppers.items():
            button.clicked.connect(lambda checked, mode=mode: self._take_up(mode if checked else "off"))
        self.show_paint(self._paint)

    def _lay_out(self) -> None:
        tools = QHBoxLayout()
        tools.addWidget(QLabel("Eyedropper"))
        for button in self.droppers.values():
            button.setMaximumWidth(64)
            tools.addWidget(button)
        tools.addStretch(1)
        tools.addWidget(self.highlight)
        grid = QGridLayout()
        grid.setHorizontalSpacing(8)
        grid.setVerticalSpacing(4)
        grid.setColumnStretch(1, 1)
        for row in self.rows.values():
            row.add_to(grid)
        vbox(self.readout, tools, grid, within=self.body, margins=(8, 4, 8, 8))

    @property
    def eyedropper(self) -> str:
        """The active eyedropper, or "off"."""
        return next((mode for mode, button in self.droppers.items() if button.isChecked()), "off")

    def show_paint(self, paint: PaintSettings) -> None:
        """Show settings without emitting."""
        self._paint = paint
        for name, row in self.rows.items():
            row.show_value(getattr(paint, name))

    def show_readout(self, vertices: int, area_mm2: float, total: int) -> None:
        """Show the size of the contact."""
        share = f"{vertices:,} of {total:,} vertices, {area_mm2:,.0f} mm² along the surface"
        none = "No vertex has this colour: use the eyedropper and click the touched paint on the scan."
        self.readout.setText(share if vertices else none)

    def show_text(self, text: str) -> None:
        """Show another text in place of the size."""
        self.readout.setText(text)

    def put_away(self) -> None:
        """Deactivate the eyedropper."""
        self._take_up("off")

    def pick(self, rgb: Uint8Array) -> None:
        """Change the ranges by colours around a click, uint8 (K, 3). Raises `EyedropperError` if none would be left."""
        paint = self._paint
        ranges = new_ranges(rgb[None], paint.color_range(), cast(Mode, self.eyedropper))
        changed = replace(paint, hue=ranges.hue, saturation=ranges.saturation, value=ranges.value)
        self.edited.emit(changed, new_gesture())

    def _take_up(self, mode: str) -> None:
        for name, button in self.droppers.items():
            button.setChecked(name == mode)
        self.eyedropperChanged.emit(mode)

    def _row_edited(self, name: str, value: Any, gesture: int) -> None:
        self.edited.emit(replace(self._paint, **{name: value}), gesture)


_AXES: Final = ("x", "y", "z")
_TURNS: Final = ("Roll", "Pitch", "Yaw")
#: Number of table rows visible at once.
_ROWS = 3
_REACH = FieldSpec(
    path="reach",
    title="ICP reach",
    description="ICP ignores pairs of points farther apart than this. Choose it larger than the current error.",
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


def _place_spec(axis: str, centre: str) -> FieldSpec:
    return FieldSpec(
        path=axis,
        title=axis,
        description=f"Position of the centre of the {centre} along {axis} of the proximity camera. "
        "Arrow keys change it by 0.1 mm, page keys by 1 mm.",
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


def _turn_spec(name: str, axis: str, thing: str) -> FieldSpec:
    return FieldSpec(
        path=name.lower(),
        title=name,
        description=(
            f"Rotation of the {thing} about {axis} of the proximity camera, in degrees: roll first, then pitch, then "
            "yaw. Arrow keys change it by 0.1°, page keys by 1°."
        ),
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

    Parameters
    ----------
    title : str
    thing : str
        What is aligned with the patch.
    centre : str
        What its centre of rotation is the centre of.
    refines : bool
        Whether there is ICP.

    Signals
    -------
    selectionChanged(number: int)
        Index of the selected pair, -1 for none.
    removeRequested(number: int)
    poseEdited(pose: float64 (4, 4), gesture: int)
    refineRequested(reach_m: float)
    """

    selectionChanged = pyqtSignal(int)
    removeRequested = pyqtSignal(int)
    poseEdited = pyqtSignal(object, int)
    refineRequested = pyqtSignal(float)

    def __init__(
        self,
        title: str = "Alignment",
        thing: str = "scan",
        centre: str = "scan's contact",
        *,
        refines: bool = True,
    ) -> None:
        super().__init__(title)
        self._thing, self._refines = thing, refines
        self._pose: Float64Array | None = None
        self._pivot = np.zeros(3)
        self.table = QTableWidget(0, 2)
        self.remove = push_button("&Delete pair", "Delete the selected pair (Del) and fit the rest again")
        self.clear = push_button("Delete all", f"Delete all pairs; the {thing} is not moved")
        self.center = push_button(
            "&Move onto patch", f"Move the centre of the {centre} to the patch's, as a start without pairs"
        )
        self.places = [NumberEntry(_place_spec(axis, centre)) for axis in _AXES]
        self.turns = [NumberEntry(_turn_spec(name, axis, thing)) for name, axis in zip(_TURNS, _AXES, strict=True)]
        self.reach = NumberEntry(_REACH)
        self.refine = push_button(
            "Re&fine by ICP", "Refine the pose by iterative closest points (ICP), starting from the current pose"
        )
        self.cancel = push_button("Cancel", "Cancel the refinement; the scan is not moved")
        self.progress = ProgressBar()
        self.outcome = wrapped_label()
        self.refusal = NoteLabel()
        self._set_up_table()
        self._lay_out()
        self._connect()
        self.show_pose(None, None)
        self.show_progress(1.0, "")

    def _set_up_table(self) -> None:
        table = self.table
        table.setHorizontalHeaderLabels(["Pair", "Residual"])
        columns, rows = read_only_table(
            table,
            "Pairs of points",
            "The clicked pairs, with the distance between both points after the fit, in millimetres",
        )
        table.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        columns.setSectionResizeMode(QHeaderView.ResizeMode.Stretch)
        table.setFixedHeight(columns.sizeHint().height() + _ROWS * rows.defaultSectionSize() + 4)

    def _lay_out(self) -> None:
        for entry in (*self.places, *self.turns):
            entry.setMinimumWidth(entry.minimumSizeHint().width())
        buttons = QHBoxLayout()
        for button in (self.remove, self.clear, self.center):
            buttons.addWidget(button)
        numbers = QGridLayout()
        numbers.setHorizontalSpacing(8)
        numbers.setVerticalSpacing(4)
        for line, (place, turn) in enumerate(zip(self.places, self.turns, strict=True)):
            for column, (text, entry) in enumerate(((_AXES[line], place), (_TURNS[line], turn))):
                numbers.addWidget(caption(text, entry), line, 2 * column)
                numbers.addWidget(entry, line, 2 * column + 1)
        numbers.setColumnStretch(1, 1)
        numbers.setColumnStretch(3, 1)
        layout = vbox(self.table, buttons, numbers, self.refusal, within=self.body, margins=(8, 4, 8, 8), spacing=4)
        if self._refines:
            icp = hbox(self.refine, caption("Reach", self.reach), self.reach, self.cancel, STRETCH)
            layout.addLayout(icp)
            layout.addWidget(self.progress)
            layout.addWidget(self.outcome)

    def _connect(self) -> None:
        self.table.itemSelectionChanged.connect(self._selected)
        self.remove.clicked.connect(lambda: self.removeRequested.emit(self.selected()))
        delete = QShortcut(QKeySequence(QKeySequence.StandardKey.Delete), self.table)
        delete.setContext(Qt.ShortcutContext.WidgetShortcut)
        delete.activated.connect(self.remove.click)
        self.refine.clicked.connect(lambda: self.refineRequested.emit(float(self.reach.value())))
        for entry in (*self.places, *self.turns):
            entry.edited.connect(lambda _, gesture: self._edited(gesture))
        for entry in (*self.places, *self.turns, self.reach):
            entry.refused.connect(partial(self.refusal.say, error=True))
            entry.edited.connect(lambda *_: self.refusal.say(""))
        for entry in (*self.places, *self.turns):
            entry.setValue(0.0)
        self.reach.setValue(_REACH.default)

    def selected(self) -> int:
        """Return the index of the selected pair, -1 for none."""
        rows = {index.row() for index in self.table.selectedIndexes()}
        return min(rows, default=-1)

    def show_pairs(self, pairs: Sequence[PickedPair], residuals_mm: Sequence[float]) -> None:
        """Show the pairs, with the residuals of the complete ones in order, or without residuals."""
        chosen = self.selected()
        left = list(residuals_mm)
        self.table.setRowCount(len(pairs))
        for number, pair in enumerate(pairs):
            if pair.complete:
                text = f"{left.pop(0):.2f} mm" if left else "–"
            else:
                text = "click it on the patch" if pair.patch is None else f"click it on the {self._thing}"
            for column, words in enumerate((str(number + 1), text)):
                item = QTableWidgetItem(words)
                item.setTextAlignment(Qt.AlignmentFlag.AlignCenter)
                self.table.setItem(number, column, item)
        if 0 <= chosen < len(pairs):
            self.table.selectRow(chosen)
        self.clear.setEnabled(bool(pairs))
        self._selected()

    def show_pose(self, pose: Matrix4 | None, pivot: Float64Array | None) -> None:
        """Show a pose and the centre of rotation in the proximity frame."""
        posed = pose is not None and pivot is not None
        for widget in (*self.places, *self.turns, self.refine, self.reach):
            widget.setEnabled(posed)
        self._pose = None if pose is None else np.asarray(pose)
        if self._pose is None or pivot is None:
            for entry in (*self.places, *self.turns):
                entry.setValue(0.0)
            return
        self._pivot = pivot
        for entry, metres in zip(self.places, pivot, strict=True):
            entry.setValue(float(metres))
        # angles that describe the same rotation, such as a typed one above 90 degrees, stay as they are
        shown = _rotation([float(entry.value()) for entry in self.turns])
        if not np.allclose(shown, self._pose[:3, :3], atol=1e-9):
            for entry, degrees in zip(self.turns, _angles(self._pose[:3, :3]), strict=True):
                entry.setValue(degrees)

    def show_progress(self, share: float, words: str) -> None:
        """Show the progress of ICP; 1 or more means that it has ended."""
        busy = share < 1
        self.progress.setVisible(busy)
        self.cancel.setVisible(busy)
        self.refine.setEnabled(not busy and self._pose is not None)
        self.progress.show_share(share, words)

    def show_refinement(self, refinement: Refinement | None) -> None:
        """Show what ICP changed."""
        if refinement is None:
            self.outcome.clear()
            return
        found = refinement.found
        more = "" if found.converged else " It has not converged yet: refine again."
        self.outcome.setText(
            f"ICP: RMSE {1e3 * refinement.before_m:.2f} mm before, {1e3 * found.rmse_m:.2f} mm after "
            f"{found.iterations} rounds, over {found.pairs:,} pairs of points.{more}"
        )

    def _selected(self) -> None:
        number = self.selected()
        self.remove.setEnabled(number >= 0)
        self.selectionChanged.emit(number)

    def _edited(self, gesture: int) -> None:
        """Use the entries: the scan is rotated about the centre of its contact."""
        if self._pose is None:
            return
        after = np.eye(4)
        after[:3, :3] = _rotation([float(entry.value()) for entry in self.turns])
        in_scan = self._pose[:3, :3].T @ (self._pivot - self._pose[:3, 3])
        place = np.array([float(entry.value()) for entry in self.places])
        after[:3, 3] = place - after[:3, :3] @ in_scan
        self.poseEdited.emit(after, gesture)


def _rotation(degrees: Sequence[float]) -> Float64Array:
    """Return the rotation matrix of roll, pitch and yaw about the fixed axes x, y and z."""
    return np.asarray(Rotation.from_euler("xyz", degrees, degrees=True).as_matrix())


def _angles(rotation: Float64Array) -> list[float]:
    """Return roll, pitch and yaw in degrees; at a pitch of 90 degrees, where roll is yaw, roll is 0."""
    pitch = np.arcsin(np.clip(-rotation[2, 0], -1.0, 1.0))
    if abs(pitch) > radians(89.9999):
        roll, yaw = 0.0, np.arctan2(-rotation[0, 1], rotation[1, 1])
    else:
        roll, yaw = np.arctan2(rotation[2, 1], rotation[2, 2]), np.arctan2(rotation[1, 0], rotation[0, 0])
    return [float(np.degrees(angle)) for angle in (roll, pitch, yaw)]


_LINES = (
    ("symmetric_rmse_mm", "Average symmetric RMSE", "Mean of both directed RMS distances to the nearest point, mm"),
    ("hausdorff_mm", "Hausdorff distance", "The largest distance to the nearest point, of either direction, mm"),
    ("percentile_95_mm", "95th percentile", "95 % of the points are closer to the other cloud than this, mm"),
    ("scan_area", "Scan's contact", "Area projected along the camera's axis, as for patches, mm²"),
    ("patch_area", "Patch", "Area projected along the camera's axis, mm²"),
    ("area_error_mm2", "Area error", "Area of the patch minus that of the scan's contact, mm² and per cent"),
)


class ResultPanel(CollapsibleSection):
    """Scores, the transform file and the command line.

    Signals
    -------
    copied()
        The command line was put on the clipboard.
    """

    copied = pyqtSignal()

    def __init__(self) -> None:
        super().__init__("Result")
        self.values = {name: QLabel("–") for name, _, _ in _LINES}
        self.save = push_button(
            "&Save transform…", "Write T_proximity_scan as JSON, for tactune evaluate recording --transform"
        )
        self.load = push_button(
            "Load &transform…", "Read the scan's pose from a file: JSON, or four lines of four numbers, metres"
        )
        self.command = QLineEdit()
        self.copy = push_button("Cop&y", "Copy the command line that repeats this result")
        self.note = wrapped_label()
        self._lay_out()
        self.copy.clicked.connect(self._copy)
        self.show_scores(None)
        self.show_command("", "")

    def _lay_out(self) -> None:
        self.command.setReadOnly(True)
        self.command.setAccessibleName("Command line")
        self.command.setPlaceholderText("the command line, once the scan is aligned")
        grid = QGridLayout()
        grid.setVerticalSpacing(4)
        grid.setColumnStretch(1, 1)
        for line, (name, title, tip) in enumerate(_LINES):
            label, value = QLabel(title), self.values[name]
            value.setAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
            value.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
            value.setAccessibleName(title)
            for widget in (label, value):
                widget.setToolTip(tip)
            grid.addWidget(label, line, 0)
            grid.addWidget(value, line, 1)
        files = QHBoxLayout()
        for button in (self.save, self.load):
            files.addWidget(button)
        repeat = hbox((self.command, 1), self.copy)
        vbox(grid, files, repeat, self.note, within=self.body, margins=(8, 4, 8, 8), spacing=4)

    def show_scores(self, scores: Scores | None) -> None:
        """Show the scores, or None."""
        if scores is None:
            for label in self.values.values():
                label.setText("–")
            return
        for name in ("symmetric_rmse_mm", "hausdorff_mm", "percentile_95_mm"):
            self.values[name].setText(_length(scores.values[name]))
        self.values["scan_area"].setText(f"{scores.scan_area_mm2:,.0f} mm²")
        self.values["patch_area"].setText(f"{scores.patch_area_mm2:,.0f} mm²")
        error = scores.values["area_error_mm2"]
        share = f" ({error / scores.scan_area_mm2:+.0%})" if scores.scan_area_mm2 > 0 else ""
        self.values["area_error_mm2"].setText(minus(f"{error:+,.0f} mm²{share}"))

    def show_command(self, command: str, note: str) -> None:
        """Show the command line, and what prevents repeating it."""
        self.command.setText(command)
        self.command.setCursorPosition(0)
        self.command.setToolTip(command or "Align the scan first")
        self.copy.setEnabled(bool(command))
        self.note.setText(note)
        self.note.setVisible(bool(note))

    def _copy(self) -> None:
        copy_text(self.command.text())
        self.copied.emit()


def _length(millimetres: float) -> str:
    return f"{millimetres:.2f} mm" if math.isfinite(millimetres) else "– (patch or contact is empty)"
