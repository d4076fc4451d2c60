"""The rig of a folder of images that has none: lenses and unit are asked for, and each gap is named."""

from __future__ import annotations

import re
from collections.abc import Collection
from functools import partial
from pathlib import Path

from PyQt6.QtWidgets import QComboBox, QDialog, QDialogButtonBox, QFormLayout, QLineEdit, QPushButton, QWidget

from ...core.calibration.rig_from_folder import FolderRig, rig_from_folder
from ...core.errors import TactuneError, as_sentence
from ...core.sources.folder import write_rig
from ...widgets.basics.controls import NoteLabel, caption, dialog_buttons, named, push_button, wrapped_label
from ...widgets.basics.dialogs import Dialogs
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from ..worker.jobs import Job

_LENSES = {"proximity": "&Proximity lens", "tactile": "&Tactile lens", "color": "Proximity &colour lens"}
_LENS_TIP = (
    "A file (camera_info.yaml, Kalibr's camchain, OpenCV's YAML, K.txt), fx,fy,cx,cy in px, or L515, D405 or D435 for "
    "the maker's values, perhaps as D405=FILE. Empty: a file beside the images."
)
LENS_FILES = "Lens files (*.yaml *.yml *.json *.xml *.txt)"
_UNITS = ("", "mm", "0.0001", "0.00025", "1/5000")


class FolderRigDialog(QDialog):
    """Asks for what the images do not state, says what is found and what is missing, and writes ``rig.json``."""

    def __init__(self, folder: Path, slots: Collection[str], dialogs: Dialogs, parent: QWidget | None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Rig of a folder of images")
        self._folder, self._dialogs = folder, dialogs.over(self)
        self.found: FolderRig | None = None
        self._job = Job(self, self._show, lambda sentence: self._refuse(sentence) if sentence else None)
        form = QFormLayout()
        two = {"proximity_depth", "tactile_depth"} <= set(slots)  # else the only depth is the tactile camera's
        roles = ["proximity", "tactile", "color"] if two and "proximity_color" in slots else list(_LENSES)[not two : 2]
        self.lenses = {role: self._add_lens(form, role) for role in roles}
        tip = "mm, metres per count such as 0.0001 or 1/5000, or proximity=UNIT,tactile=UNIT"
        self.unit = named(QComboBox(), "Unit of the depth", tip)
        self.unit.setEditable(True)
        self.unit.addItems(_UNITS)
        form.addRow("&Unit of depth", self.unit)
        self.note, self.about = NoteLabel(lines=3), NoteLabel()
        self.buttons = dialog_buttons(QDialogButtonBox.StandardButton.Open | QDialogButtonBox.StandardButton.Cancel)
        self._open = self.buttons.button(QDialogButtonBox.StandardButton.Open) or QPushButton()
        intro = f"{folder}\nThese images have no rig.json; Open writes it. State what their files do not state."
        vbox(wrapped_label(intro), form, self.note, self.about, STRETCH, self.buttons, within=self)
        self.unit.currentTextChanged.connect(self._look)
        self.buttons.accepted.connect(self.accept)
        self.buttons.rejected.connect(self.reject)
        self.finished.connect(lambda _: self._job.stop())
        self.resize(720, 360)
        self._look()

    def accept(self) -> None:
        """Write the rig; the dialog stays if that fails."""
        assert self.found is not None  # else Open is disabled
        try:
            write_rig(self._folder, self.found.rig, self.found.forms)
        except TactuneError as error:
            self._refuse(str(error))
            return
        super().accept()

    def _add_lens(self, form: QFormLayout, role: str) -> QLineEdit:
        title, choose = _LENSES[role], push_button("Choose…", "Choose the file of this lens")
        field = named(QLineEdit(), title.replace("&", ""), _LENS_TIP)
        field.setPlaceholderText("as a file beside the images states it")
        form.addRow(caption(title, field), hbox((field, 1), choose))
        field.textChanged.connect(self._look)
        take = partial(self._take, field)
        choose.clicked.connect(lambda: self._dialogs.open_file("lens", "Open the file of a lens", LENS_FILES, take))
        return field

    def _take(self, field: QLineEdit, path: Path) -> None:
        model, equals, _ = field.text().partition("=")
        field.setText(f"{model}={path}" if equals else str(path))

    def _look(self) -> None:
        """Find out what the rig would be."""
        self.found = None
        self._open.setEnabled(False)
        options = {role: field.text().strip() or None for role, field in self.lenses.items()}
        unit = self.unit.currentText().strip() or None
        self._job.cancel()  # of what was typed before
        self._job.start(lambda _: rig_from_folder(self._folder, options, unit))

    def _show(self, found: FolderRig) -> None:
        self.found = found
        self._open.setEnabled(True)
        self.note.say("")
        self.about.setText("\n".join(_plain(line) for line in (*found.notes, *found.warnings)))

    def _refuse(self, sentence: str) -> None:
        self.note.say(_plain(sentence), error=True)
        self.about.clear()


def _plain(sentence: str) -> str:
    """Return a sentence of the core without the options of the command line."""
    return as_sentence(re.sub(r" \(--[^)]*\)", "", sentence))
