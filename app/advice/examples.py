"""Examples of contact: frames that a person marked as touched within a rectangle, or as untouched; and their window."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PyQt6.QtCore import QObject
from PyQt6.QtWidgets import QDialog, QListWidget

from ...core.calibration.snapshots import content_hash
from ...core.errors import TactuneError
from ...core.model.frames import Rig
from ...core.tuning.advice.proposal import Example
from ...widgets.basics.controls import push_button, wrapped_label
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from ...widgets.images.image_pane import ImagePane
from ...widgets.images.marks import RegionItem
from ..calibration.pictures import picture
from ..calibration.session import rig_key
from ..context import Context
from ..document.document import History
from ..document.keeping import KeptState

#: Left, top, width, height in proximity pixels.
Rectangle = tuple[int, int, int, int]


@dataclass(frozen=True, eq=False)
class MarkedFrame:
    """An example and the name of its file, which follows from the frame's images."""

    key: str
    example: Example

    def with_contact(self, rectangle: Rectangle | None) -> MarkedFrame:
        """Return it with contact in another rectangle, or nowhere."""
        frame = self.example.frame
        if rectangle is None:
            return replace(self, example=Example(frame))
        left, top, width, height = rectangle
        contact = np.zeros(frame.proximity_depth.shape, bool)
        contact[top : top + height, left : left + width] = True
        return replace(self, example=Example(frame, contact))

    @property
    def rectangle(self) -> Rectangle | None:
        """Bounding box of the contact; None without any."""
        v, u = np.nonzero(self.example.mask)
        if not len(u):
            return None
        return int(u.min()), int(v.min()), int(np.ptp(u)) + 1, int(np.ptp(v)) + 1

    @property
    def title(self) -> str:
        """What is known of it, for the list."""
        box = self.rectangle
        return "untouched" if box is None else f"touched in {box[2]} × {box[3]} px"


State = tuple[MarkedFrame, ...]


class ExampleHistory(History[State]):
    """The examples of one rig; every mark and deletion is one undoable step."""

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__((), parent)
        #: The rig that took the frames; None before the first source.
        self.rig: Rig | None = None
        self.undo_stack.setUndoLimit(100)

    @property
    def examples(self) -> tuple[Example, ...]:
        return tuple(marked.example for marked in self.state)

    def mark(self, marked: MarkedFrame, text: str, gesture: int = 0) -> None:
        """Add an example, or replace that of the same frame."""
        if any(other.key == marked.key for other in self.state):
            self.edit(text, tuple(marked if other.key == marked.key else other for other in self.state), gesture)
        else:
            self.edit(text, (*self.state, marked))

    def delete(self, key: str) -> None:
        self.edit("Delete example", tuple(marked for marked in self.state if marked.key != key))


class ExampleKeeper(KeptState[State]):
    """Keeps the examples of each rig in a folder of its own, one file for each example."""

    advice = "; examples are lost when the window closes"

    def __init__(self, history: ExampleHistory, folder: Path, parent: QObject | None = None) -> None:
        self._history = history
        super().__init__(folder, "examples", parent)
        self._stored: State = ()
        history.changed.connect(self.schedule)

    def present(self) -> State:
        return self._history.state

    def switch_to(self, rig: Rig) -> None:
        """Save the examples of the present rig, and show those of another one."""
        if rig == self._history.rig:
            return
        self.flush()
        self.wait()
        self._history.rig = rig
        file = self.folder / rig_key(rig)
        self._stored = self._read(file, rig)
        self.follow(file, self._stored)
        self._history.start(self._stored)

    def write(self, state: State, file: Path) -> None:
        for marked in set(state) - set(self._stored):
            marked.example.save(_file_of(file, marked.key))
        for key in {marked.key for marked in self._stored} - {marked.key for marked in state}:
            _file_of(file, key).unlink(missing_ok=True)
        self._stored = state

    def _read(self, folder: Path, rig: Rig) -> State:
        found = []
        for file in sorted(folder.glob("example-*.npz")):
            try:
                example = Example.load(file)
                example.frame.check_against(rig)
            except TactuneError as error:
                with suppress(OSError):
                    file.replace(file.with_suffix(".damaged"))
                self.failed.emit(f"An example was set aside: {error}.")
            else:
                found.append(MarkedFrame(file.stem.removeprefix("example-"), example))
        return tuple(found)


def _file_of(folder: Path, key: str) -> Path:
    return folder / f"example-{key}.npz"


class ExamplesWindow(QDialog):
    """A list of examples, and the selected one with its rectangle of contact."""

    def __init__(self, context: Context, history: ExampleHistory) -> None:
        super().__init__(context.window)
        self.setWindowTitle("Examples of contact – Tactune")
        self._context, self._history = context, history
        self.untouched = push_button(
            "Nothing touches in this &frame", "Mark the main window's frame as untouched: all contact in it is false"
        )
        self.touched = push_button(
            "&Contact in this frame", "Mark a rectangle of contact in the main window's frame; nothing touches outside"
        )
        self.list = QListWidget()
        self.list.setAccessibleName("Examples")
        self.list.setToolTip("The examples; Delete removes the selected one")
        self.delete = push_button("De&lete", "Delete the selected example (Delete)", "Delete")
        self.undo = push_button("&Undo", "Undo the last mark or deletion (Ctrl+Z)", "Ctrl+Z")
        self.redo = push_button("&Redo", "Redo what was undone (Ctrl+Shift+Z)", "Ctrl+Shift+Z")
        self.image = ImagePane("Contact by hand")
        self.region = RegionItem(self.image)
        self.leave = push_button("&Close", "Close this window (Esc); the examples are kept")
        intro = wrapped_label(
            "Examples tell suggestions what is contact: frames in which nothing touches the membrane, and frames in "
            "which a flat object touches it. Drag the rectangle onto the contact."
        )
        left = vbox(self.untouched, self.touched, (self.list, 1), hbox(self.delete, self.undo, self.redo))
        self.list.setFixedWidth(270)
        vbox(intro, (hbox(left, (self.image, 1)), 1), hbox(STRETCH, self.leave), within=self)
        self.resize(920, 640)
        history.changed.connect(self._show_state)
        history.undo_stack.indexChanged.connect(self._show_buttons)
        context.frameShown.connect(self._show_buttons)
        self.untouched.clicked.connect(lambda: self._add(touched=False))
        self.touched.clicked.connect(lambda: self._add(touched=True))
        self.list.currentRowChanged.connect(lambda _: self._show_example())
        self.delete.clicked.connect(self._delete)
        self.undo.clicked.connect(history.undo_stack.undo)
        self.redo.clicked.connect(history.undo_stack.redo)
        self.region.edited.connect(self._drag)
        self.image.resized.connect(lambda: self.image.show_rect(self.image.image_rect()))
        self.leave.clicked.connect(self.reject)
        self._show_state(history.state)

    @property
    def marked(self) -> MarkedFrame | None:
        row, state = self.list.currentRow(), self._history.state
        return state[row] if 0 <= row < len(state) else None

    def _add(self, *, touched: bool) -> None:
        """Mark the main window's frame; contact begins as the middle of the image."""
        result = self._context.result
        if result is None or result.source.rig != self._history.rig:
            return
        height, width = result.frame.proximity_depth.shape
        middle = (width // 3, height // 3, width // 3, height // 3)
        key = content_hash(result.frame)[:16]
        marked = MarkedFrame(key, Example(result.frame)).with_contact(middle if touched else None)
        self._history.mark(marked, "Mark contact" if touched else "Mark as untouched")
        self.list.setCurrentRow([other.key for other in self._history.state].index(marked.key))

    def _drag(self, rectangle: Rectangle, gesture: int) -> None:
        if self.marked is not None:
            self._history.mark(self.marked.with_contact(rectangle), "Mark contact", gesture)

    def _delete(self) -> None:
        if self.marked is not None:
            self._history.delete(self.marked.key)

    def _show_state(self, state: State) -> None:
        row = self.list.currentRow()
        self.list.blockSignals(True)
        self.list.clear()
        self.list.addItems([f"Frame {marked.example.frame.sequence + 1}: {marked.title}" for marked in state])
        self.list.setCurrentRow(min(max(row, 0), len(state) - 1))
        self.list.blockSignals(False)
        self._show_example()
        self._show_buttons()

    def _show_buttons(self) -> None:
        stack = self._history.undo_stack
        self.undo.setEnabled(stack.canUndo())
        self.redo.setEnabled(stack.canRedo())
        for button in (self.untouched, self.touched):
            button.setEnabled(self._context.result is not None)

    def _show_example(self) -> None:
        marked, rig = self.marked, self._history.rig
        self.delete.setEnabled(marked is not None)
        if marked is None or rig is None:
            self.image.set_pixels(None, (1, 1), 1)
            self.image.set_message("Mark a frame of the main window.")
            self.region.set_rectangle(None)
            return
        pixels = picture(marked.example.frame, rig, "proximity", "depth").pixels
        self.image.set_pixels(pixels, (pixels.shape[1], pixels.shape[0]), 1)
        self.image.set_message("")
        self.image.show_rect(self.image.image_rect())
        self.region.set_rectangle(marked.rectangle)
