"""The dialog *Create rig…*: describes the two cameras of a folder of images and writes its ``rig.json``."""

from __future__ import annotations

from PyQt6.QtCore import Qt, pyqtSignal
from PyQt6.QtWidgets import QDialog, QDialogButtonBox, QFrame, QScrollArea, QWidget

from ...core.calibration.lens import make_rig
from ...core.errors import TactuneError, counted
from ...core.model.frames import Rig
from ...core.sources.folder_rig import RIG_FILE, FolderImages, write_rig
from ...widgets.basics.controls import NoteLabel, dialog_buttons, wrapped_label
from ...widgets.basics.layouts import hbox, vbox
from .camera_form import CameraForm

_NO_POSE = "The pose of the cameras to each other is not asked for: align them with Calibrate… (Ctrl+K) afterwards."
_COLOR_POSE = (
    "\nThe proximity colour images have another size than the depth images, so they need a lens of their own; both "
    "cameras are taken to stand in the same place."
)


class RigDialog(QDialog):
    """Asks for the cameras of a folder that lacks ``rig.json``.

    Signals
    -------
    created(name: str)
        The file is written; the name of the source.
    """

    created = pyqtSignal(str)

    def __init__(self, images: FolderImages, native_dialogs: bool = True, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Create rig")
        self._images = images
        self.found = wrapped_label(_in_words(images))
        self.found.setTextFormat(Qt.TextFormat.PlainText)
        self.note = NoteLabel(lines=2)
        self.forms = self._make_forms(native_dialogs)
        self.buttons = dialog_buttons(QDialogButtonBox.StandardButton.Cancel)
        create = self.buttons.addButton("&Create and open", QDialogButtonBox.ButtonRole.AcceptRole)
        assert create is not None
        self.write = create
        self.write.setToolTip(f"Write {RIG_FILE} into the folder and open it")
        self._lay_out()
        self.buttons.accepted.connect(self._write)
        self.buttons.rejected.connect(self.reject)
        for form in self.forms.values():
            form.failed.connect(lambda sentence: self.note.say(sentence, error=True))
            form.changed.connect(lambda: self.note.say(_NO_POSE))
            self.finished.connect(form.stop)
        self.note.say(images.problem or _NO_POSE, error=bool(images.problem))
        self.write.setEnabled(not images.problem)

    def rig(self) -> Rig:
        """Return the rig that the fields describe.

        Raises
        ------
        TactuneError
            A field is empty, no number, out of range or implausible.
        """
        return make_rig({key: form.values() for key, form in self.forms.items()})

    def _make_forms(self, native_dialogs: bool) -> dict[str, CameraForm]:
        """Return a form for each camera whose images were found, by its key in the file."""
        sizes = self._images.sizes
        wanted = {"proximity": ("Proximity camera", "proximity_depth.png", "L515")}
        if self._images.has_own_color_lens:
            wanted["proximity_color"] = ("Proximity colour camera", "proximity_color.png", "L515")
        wanted["tactile"] = ("Tactile camera", "tactile_depth.png", "D405")
        return {
            key: CameraForm(
                title, sizes[image], model, has_depth=key != "proximity_color", native_dialogs=native_dialogs
            )
            for key, (title, image, model) in wanted.items()
            if image in sizes
        }

    def _lay_out(self) -> None:
        inside = QWidget()
        hbox(*self.forms.values(), within=inside, margins=0)
        scroll = QScrollArea()
        scroll.setWidget(inside)
        scroll.setWidgetResizable(True)
        scroll.setFrameShape(QFrame.Shape.NoFrame)
        vbox(self.found, (scroll, 1), self.note, self.buttons, within=self)
        self.write.setDefault(True)  # not before: a dialog chooses its own when buttons come into it
        self.resize(max(420 * len(self.forms), 640), 560)

    def _write(self) -> None:
        try:
            write_rig(self._images.path, self.rig())
        except TactuneError as error:
            self.note.say(str(error), error=True)
            return
        self.accept()
        self.created.emit(f"folder:{self._images.path}")


def _in_words(images: FolderImages) -> str:
    lines = [f"{images.path}: {counted(images.frames, 'frame')}"]
    for role in ("proximity", "tactile"):
        found = []
        for name in (f"{role}_depth.png", f"{role}_color.png"):
            size = images.sizes.get(name)
            found.append(f"{name} {size[0]} x {size[1]}" if size else f"no {name}")
        lines.append(f"{role.capitalize()}: {', '.join(found)}")
    if images.different:
        lines.append(f"Not all frames can be read: {images.different}.")
    return "\n".join(lines) + (_COLOR_POSE if images.has_own_color_lens else "")
