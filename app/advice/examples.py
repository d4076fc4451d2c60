"""Examples of contact: the frames that a person marked or painted, their undo, and the files that keep them."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PyQt6.QtCore import QObject

from ...core.calibration.snapshots import content_hash
from ...core.errors import TactuneError
from ...core.model.arrays import Uint8Array
from ...core.model.frames import Rig, SensorFrame
from ...core.tuning.advice.example_file import load_example, save_example
from ...core.tuning.advice.proposal import Example
from ...widgets.images.paint_image import CONTACT, NO_CONTACT, UNKNOWN
from ..calibration.session import rig_key
from ..document.history import History
from ..document.keeping import KeptState


@dataclass(frozen=True, eq=False)
class MarkedFrame:
    """An example and the name of its file, which follows from the frame's images."""

    key: str
    example: Example

    @classmethod
    def of(cls, frame: SensorFrame, labels: Uint8Array) -> MarkedFrame:
        """Return a frame with labels, uint8 (H, W) as `PaintImage` paints them."""
        return cls(content_hash(frame)[:16], Example(frame)).with_labels(labels)

    def with_labels(self, labels: Uint8Array) -> MarkedFrame:
        """Return it with other labels; all of them *no contact* are an untouched frame."""
        frame = self.example.frame
        if (labels == NO_CONTACT).all():
            return replace(self, example=Example(frame))
        return replace(self, example=Example(frame, labels == CONTACT, labels != UNKNOWN))

    @property
    def labels(self) -> Uint8Array:
        """The labels, uint8 (H, W)."""
        labels = np.full(self.example.frame.proximity_depth.shape, NO_CONTACT, np.uint8)
        if self.example.known is not None:
            labels[~self.example.known] = UNKNOWN
        if self.example.contact is not None:
            labels[self.example.contact] = CONTACT
        return labels

    @property
    def title(self) -> str:
        """What is known of it, for the list."""
        known, contact = self.example.known, self.example.contact
        if contact is None and known is None:
            return "Untouched"
        if known is not None and not known.any():
            return "Nothing painted yet"
        share = 0.0 if known is None else 100.0 * float(known.mean())
        return f"Painted, {share:.1f} % known"


State = tuple[MarkedFrame, ...]


class ExampleHistory(History[State]):
    """The examples of one rig; every mark, stroke and deletion is one undoable step."""

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__((), parent)
        #: The rig that took the frames; None before the first source.
        self.rig: Rig | None = None
        self.undo_stack.setUndoLimit(100)  # each step of painting holds two masks of the image's size

    @property
    def examples(self) -> tuple[Example, ...]:
        """The examples that are marked as untouched or have painted contact."""
        every = (marked.example for marked in self.state)
        return tuple(example for example in every if example.known is None or example.known.any())

    def mark(self, marked: MarkedFrame, text: str) -> None:
        """Add an example, or replace that of the same frame."""
        if any(other.key == marked.key for other in self.state):
            self.edit(text, tuple(marked if other.key == marked.key else other for other in self.state))
        else:
            self.edit(text, (*self.state, marked))

    def delete(self, key: str) -> None:
        """Delete an example."""
        self.edit("Delete example", tuple(marked for marked in self.state if marked.key != key))


class ExampleKeeper(KeptState[State]):
    """Keeps the examples of each rig in a folder of its own, one file for each example."""

    advice = "; examples are lost when the window closes"

    def __init__(self, history: ExampleHistory, folder: Path, parent: QObject | None = None) -> None:
        self._history = history
        super().__init__(folder, "examples", parent)
        self._stored: dict[Path, dict[str, MarkedFrame]] = {}
        self._seen: dict[Path, State] = {}
        history.changed.connect(self.schedule)

    def present(self) -> State:
        """Return the examples."""
        return self._history.state

    def switch_to(self, rig: Rig) -> None:
        """Save the examples of the present rig, and show those of another one."""
        if rig == self._history.rig:
            return
        self.flush()
        if self.file is not None:
            self._seen[self.file] = self._history.state
        self._history.rig = rig
        file = self.folder / rig_key(rig)
        state = self._seen[file] if file in self._seen else self._read(file, rig)
        self.follow(file, state)
        self._history.start(state)

    def write(self, state: State, file: Path) -> None:
        """Write the examples that are new or changed, and remove the files of deleted ones."""
        stored = self._stored.setdefault(file, {})
        for marked in state:
            if stored.get(marked.key) is not marked:
                save_example(marked.example, _file_of(file, marked.key))
                stored[marked.key] = marked
        for key in stored.keys() - {marked.key for marked in state}:
            _file_of(file, key).unlink(missing_ok=True)
            del stored[key]

    def _read(self, folder: Path, rig: Rig) -> State:
        found = []
        for file in sorted(folder.glob("example-*.npz")):
            try:
                example = load_example(file)
                example.frame.check_against(rig)
            except TactuneError as error:
                with suppress(OSError):
                    file.replace(file.with_suffix(".damaged"))
                self.failed.emit(f"An example was set aside: {error}.")
                continue
            found.append(MarkedFrame(file.stem.removeprefix("example-"), example))
        self._stored[folder] = {marked.key: marked for marked in found}
        return tuple(found)


def _file_of(folder: Path, key: str) -> Path:
    return folder / f"example-{key}.npz"
