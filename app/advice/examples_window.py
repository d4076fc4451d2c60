"""The window in which frames are marked as untouched and contact is painted."""

from __future__ import annotations

from functools import partial

import cv2
import numpy as np
from PyQt6.QtCore import QSize, Qt
from PyQt6.QtGui import QIcon, QImage, QKeyEvent, QPixmap, QShowEvent
from PyQt6.QtWidgets import (
    QButtonGroup,
    QCheckBox,
    QComboBox,
    QDialog,
    QListWidget,
    QListWidgetItem,
    QSpinBox,
)

from ...core.contact.pipeline import ContactPipeline
from ...core.model.arrays import BoolArray, Uint8Array
from ...core.model.clouds import valid_depth
from ...core.model.frames import Rig, SensorFrame
from ...core.preset import Preset
from ...widgets.basics.controls import AccentButton, caption, push_button, wrapped_label
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from ...widgets.images.paint_image import CONTACT, MAX_RADIUS, NO_CONTACT, UNKNOWN, PaintImage, tint_labels
from ..calibration.pictures import pack_rgb, picture
from ..context import Context
from ..worker.jobs import Job
from ..worker.rendering import aligned_color
from .examples import ExampleHistory, MarkedFrame, State

_THUMBNAIL = QSize(96, 72)
_INTRO = (
    "Examples tell suggestions what is contact: frames of the untouched membrane, and frames in which you paint "
    "contact. They are kept for this pair of cameras."
)
_NONE = "Mark a frame of the main window as untouched, or paint contact in it."
_TOOLS = {
    "brush": ("&Brush", "Paint with a round brush; the right button or Shift erases"),
    "disc": ("&Disc", "Pick a round object: press at its centre and drag its radius. Contact inside, none outside"),
    "rectangle": ("&Rectangle", "Pick a flat object: drag from corner to corner. Contact inside, none outside"),
}
_VALUES = {
    CONTACT: ("&Contact", "The brush marks contact"),
    NO_CONTACT: ("&No contact", "The brush marks what does not touch"),
    UNKNOWN: ("Un&known", "The brush erases: suggestions ignore these pixels"),
}
_IMAGES = {"color": "Colour", "depth": "Depth", "relative": "Relief"}


class ExamplesWindow(QDialog):
    """A list of examples, and the selected one to paint in."""

    def __init__(self, context: Context, history: ExampleHistory) -> None:
        super().__init__(context.window)
        self.setWindowTitle("Examples of contact – Tactune")
        self._context, self._history = context, history
        self._icons: dict[MarkedFrame, QIcon] = {}
        self._patches = Job(self)
        self._make_controls()
        self._lay_out()
        self._connect()
        self._show_state(history.state)

    def _make_controls(self) -> None:
        self.untouched = push_button(
            "Mark this frame as &untouched",
            "Nothing touches the membrane in the main window's frame: all contact is false",
        )
        self.paint = push_button("&Paint this frame", "Add the main window's frame and paint contact in it")
        self.list = QListWidget()
        self.list.setIconSize(_THUMBNAIL)
        self.list.setAccessibleName("Examples")
        self.list.setToolTip("The examples; Delete removes the selected one")
        self.delete = push_button("De&lete", "Delete the selected example (Delete)")
        self.undo = push_button("Undo", "Undo the last mark, stroke or deletion (Ctrl+Z)", "Ctrl+Z")
        self.redo = push_button("Redo", "Redo what was undone (Ctrl+Shift+Z)", "Ctrl+Shift+Z")
        self.image = PaintImage("Contact by hand")
        self.tools = {name: AccentButton(*words) for name, words in _TOOLS.items()}
        self.values = {value: AccentButton(*words) for value, words in _VALUES.items()}
        for buttons, chosen in ((self.tools, "brush"), (self.values, CONTACT)):
            group = QButtonGroup(self)
            for button in buttons.values():
                group.addButton(button)
            buttons[chosen].setChecked(True)  # type: ignore[index]
        self.brush_size = QSpinBox()
        self.brush_size.setRange(1, MAX_RADIUS)
        self.brush_size.setValue(self.image.radius)
        self.brush_size.setSuffix(" px")
        self.brush_size.setToolTip("Radius of the brush in proximity pixels; also by the wheel, [ and ]")
        self.rest = push_button("Rest: n&one", "Mark everything that is unknown as no contact")
        self.clear = push_button("Cl&ear", "Make the whole frame unknown")
        self.choice = QComboBox()
        for name, title in _IMAGES.items():
            self.choice.addItem(title, name)
        self.choice.setToolTip("The image that is painted on; all are in proximity pixels")
        self.overlay = QCheckBox("Pa&tch")
        self.overlay.setChecked(True)
        self.overlay.setToolTip("Outline the patch that the present preset finds in this frame")
        self.leave = push_button("Close", "Close this window (Esc); the examples are kept")

    def _lay_out(self) -> None:
        left = vbox(self.untouched, self.paint, (self.list, 1), hbox(self.delete, self.undo, self.redo))
        tools = hbox(*self.tools.values(), *self.values.values(), STRETCH)
        brush = (caption("Si&ze", self.brush_size), self.brush_size, self.rest, self.clear)
        shown = hbox(caption("&Image", self.choice), self.choice, self.overlay)
        more = hbox(*brush, STRETCH, shown)
        right = vbox(tools, more, (self.image, 1))
        across = hbox(left, (right, 1))
        intro = wrapped_label(_INTRO)
        row = hbox(STRETCH, self.leave)
        vbox(intro, (across, 1), row, within=self)
        self.list.setFixedWidth(270)
        self.list.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.resize(920, 640)

    def _connect(self) -> None:
        history = self._history
        history.changed.connect(self._show_state)
        history.undo_stack.indexChanged.connect(self._show_undo)
        self.untouched.clicked.connect(lambda: self._add(NO_CONTACT, "Mark as untouched"))
        self.paint.clicked.connect(lambda: self._add(UNKNOWN, "Paint a frame"))
        self.list.currentRowChanged.connect(lambda _: self._show_example())
        self.delete.clicked.connect(self._delete)
        self.undo.clicked.connect(history.undo_stack.undo)
        self.redo.clicked.connect(history.undo_stack.redo)
        self.image.painted.connect(lambda labels: self._edit("Paint", labels))
        self.image.radiusChanged.connect(self.brush_size.setValue)
        self.brush_size.valueChanged.connect(self.image.set_radius)
        for name, tool in self.tools.items():
            tool.clicked.connect(partial(self._choose_tool, name))
        for value, button in self.values.items():
            button.clicked.connect(partial(self._choose_value, value))
        self.rest.clicked.connect(self._fill_rest)
        self.clear.clicked.connect(self._clear)
        self.choice.currentIndexChanged.connect(lambda _: self._show_example())
        self.overlay.toggled.connect(lambda _: self._request_patch())
        self.leave.clicked.connect(self.reject)
        self._patches.done.connect(self._show_patch)
        self._context.document.presetChanged.connect(lambda _: self._request_patch())
        self._context.frameShown.connect(self._show_undo)

    @property
    def marked(self) -> MarkedFrame | None:
        """The selected example."""
        row, state = self.list.currentRow(), self._history.state
        return state[row] if 0 <= row < len(state) else None

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        """Delete the selected example where the list has the keyboard."""
        if event is not None and event.key() == Qt.Key.Key_Delete and self.list.hasFocus():
            self._delete()
        else:
            super().keyPressEvent(event)

    def close_down(self) -> None:
        """Close the window for good."""
        self._history.close()
        self.reject()
        self._patches.stop()

    # Editing

    def _add(self, label: int, text: str) -> None:
        result = self._context.result
        if result is None or result.source.rig != self._history.rig:
            return
        labels = np.full(result.frame.proximity_depth.shape, label, np.uint8)
        marked = MarkedFrame.of(result.frame, labels)
        known = [other.key for other in self._history.state]
        if label == UNKNOWN and marked.key in known:
            self.list.setCurrentRow(known.index(marked.key))  # what was painted stays
            return
        self._history.mark(marked, text)
        self.list.setCurrentRow([other.key for other in self._history.state].index(marked.key))

    def _edit(self, text: str, labels: Uint8Array) -> None:
        if self.marked is not None:
            self._history.mark(self.marked.with_labels(labels), text)

    def _fill_rest(self) -> None:
        if self.marked is not None:
            labels = self.marked.labels
            self._edit("Rest: no contact", np.where(labels == UNKNOWN, np.uint8(NO_CONTACT), labels))

    def _clear(self) -> None:
        if self.marked is not None:
            self._edit("Clear", np.full_like(self.marked.labels, UNKNOWN))

    def _delete(self) -> None:
        if self.marked is not None:
            self._history.delete(self.marked.key)

    def _choose_tool(self, name: str) -> None:
        self.image.tool = name  # type: ignore[assignment]
        for button in self.values.values():
            button.setEnabled(name == "brush")

    def _choose_value(self, value: int) -> None:
        self.image.value = value

    # Showing

    def _show_state(self, state: State) -> None:
        row = self.list.currentRow()
        self.list.blockSignals(True)
        self.list.clear()
        self._icons = {marked: self._icons.get(marked) or self._thumbnail(marked) for marked in state}
        for marked in state:
            self.list.addItem(
                QListWidgetItem(self._icons[marked], f"Frame {marked.example.frame.sequence + 1}\n{marked.title}")
            )
        self.list.setCurrentRow(min(max(row, 0), len(state) - 1))
        self.list.blockSignals(False)
        self._show_example()
        self._show_undo()

    def _show_undo(self) -> None:
        stack = self._history.undo_stack
        self.undo.setEnabled(stack.canUndo())
        self.redo.setEnabled(stack.canRedo())
        there = self._context.result is not None
        self.untouched.setEnabled(there)
        self.paint.setEnabled(there)

    def _show_example(self) -> None:
        marked, rig = self.marked, self._history.rig
        for widget in (self.delete, self.rest, self.clear, self.brush_size):
            widget.setEnabled(marked is not None)
        if marked is None or rig is None:
            self.image.set_image(None, None, _NONE)
            self.image.set_outline(None)
            return
        self.image.set_image(_pixels(marked.example.frame, rig, self.choice.currentData()), marked.labels)
        self._request_patch()

    def _thumbnail(self, marked: MarkedFrame) -> QIcon:
        if self._history.rig is None:
            return QIcon()
        pixels = _pixels(marked.example.frame, self._history.rig, "color")
        tint_labels(pixels, marked.labels)
        small = cv2.resize(pixels, (_THUMBNAIL.width(), _THUMBNAIL.height()), interpolation=cv2.INTER_AREA)
        image = QImage(small.tobytes(), small.shape[1], small.shape[0], 4 * small.shape[1], QImage.Format.Format_RGB32)
        return QIcon(QPixmap.fromImage(image.copy()))

    def _request_patch(self) -> None:
        marked, rig = self.marked, self._history.rig
        if marked is None or rig is None or not self.isVisible() or not self.overlay.isChecked():
            self.image.set_outline(None)
            return
        preset = self._context.document.preset
        self._patches.start(lambda _: (marked.key, _patch_of(preset, rig, marked.example.frame)))

    def _show_patch(self, found: tuple[str, BoolArray]) -> None:
        if self.marked is not None and self.marked.key == found[0] and self.overlay.isChecked():
            self.image.set_outline(found[1])

    def showEvent(self, event: QShowEvent | None) -> None:
        """Find the patch that was not looked for while the window was closed."""
        super().showEvent(event)
        self._show_state(self._history.state)


def _patch_of(preset: Preset, rig: Rig, frame: SensorFrame) -> BoolArray:
    return ContactPipeline(preset, rig).process(frame).mask


def _pixels(frame: SensorFrame, rig: Rig, choice: str) -> Uint8Array:
    """Draw the proximity image of a frame in depth pixels, uint8 (H, W, 4)."""
    if choice != "color":
        return picture(frame, rig, "proximity", "depth" if choice == "depth" else "relative", stretch=True).pixels
    valid = valid_depth(frame.proximity_depth)
    depth_m = frame.proximity_depth * np.float32(rig.proximity.depth_unit_m)
    typical_m = float(np.median(depth_m[valid])) if valid.any() else 0.3
    return pack_rgb(aligned_color(frame, rig, depth_m, valid, typical_m))
