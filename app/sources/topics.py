"""What foreign images do not say by themselves, asked before they are opened: topics of a recording, with pictures."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from PyQt6.QtCore import QObject, QSize, Qt
from PyQt6.QtGui import QIcon, QImage, QPixmap
from PyQt6.QtWidgets import QDialog, QDialogButtonBox, QGridLayout, QLabel, QPushButton, QWidget

from ...core.errors import as_sentence
from ...core.sources.registry import images_without_rig, topics_to_choose
from ...core.sources.ros.recording import Inspection
from ...widgets.basics.controls import ChoiceBox, NoteLabel, caption, dialog_buttons, named, push_button, wrapped_label
from ...widgets.basics.dialogs import Dialogs
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from ..worker.jobs import Job
from .folder_rig_dialog import LENS_FILES, FolderRigDialog

_SLOTS = {
    "proximity.depth": ("&Proximity depth", "The camera that looks through the membrane at the object"),
    "proximity.color": (
        "Proximity &colour",
        "Colour of the same camera, for the mask of the prints; it may be missing",
    ),
    "tactile.depth": ("&Tactile depth", "The camera that sees the membrane itself"),
    "tactile.color": ("Tactile c&olour", "Colour of the same camera; it may be missing"),
}
#: Schemes of sources that have no topics to ask for.
WITHOUT_TOPICS = ("sim", "live", "cameras", "realsense", "ros2")
_NONE = "none"
_PICTURE_SIZE, _ICON_SIZE = QSize(160, 120), QSize(48, 36)


class TopicsDialog(QDialog):
    """Asks for the topic of each image; the guess is chosen already."""

    def __init__(self, name: str, found: Inspection, dialogs: Dialogs, parent: QWidget | None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Topics of the recording")
        self._found, self._dialogs = found, dialogs.over(self)
        self._lenses: dict[str, Path] = {}  # by slot, where the recording has none
        self.lens = push_button("Lens &file…", "Choose the file of the lens that the recording lacks")
        self.lens.clicked.connect(self._ask_lens)
        self.choices: dict[str, ChoiceBox] = {}
        self._pictures: dict[str, QLabel] = {}
        grid = QGridLayout()
        kinds = {image.kind for image in found.images}
        for number, slot in enumerate(slot for slot in _SLOTS if slot.partition(".")[2] in kinds):
            self._add(grid, number, slot)
        self.note = NoteLabel(lines=2)
        self.buttons = dialog_buttons(QDialogButtonBox.StandardButton.Open | QDialogButtonBox.StandardButton.Cancel)
        self._open = self.buttons.button(QDialogButtonBox.StandardButton.Open) or QPushButton()
        guessed = "Guessed from names and types. Check the pictures."
        if found.gap:
            guessed = f"{as_sentence(found.gap)} Choose by the pictures."
        row = hbox((self.note, 1), self.lens)
        vbox(wrapped_label(f"{name}\n{guessed}"), grid, row, STRETCH, self.buttons, within=self)
        self.buttons.accepted.connect(self.accept)
        self.buttons.rejected.connect(self.reject)
        self._show()

    def _add(self, grid: QGridLayout, number: int, slot: str) -> None:
        title, tip = _SLOTS[slot]
        choice, picture = named(ChoiceBox(), title.replace("&", ""), tip), QLabel()
        choice.addItem(_NONE, "")
        for image in self._found.images:
            if image.kind == slot.partition(".")[2]:
                choice.addItem(QIcon(self._pixmap(image.name)), image.name, image.name)
                choice.setItemData(choice.count() - 1, str(image), Qt.ItemDataRole.ToolTipRole)
        choice.setCurrentIndex(max(0, choice.findData(self._found.guess.get(slot, ""))))
        choice.setIconSize(_ICON_SIZE)
        choice.setMinimumContentsLength(36)
        picture.setFixedHeight(_PICTURE_SIZE.height())
        self.choices[slot], self._pictures[slot] = choice, picture
        row, column = divmod(number, 2)
        for line, widget in enumerate((caption(title, choice), choice, picture)):
            grid.addWidget(widget, 3 * row + line, column)
        choice.currentIndexChanged.connect(self._show)
        if slot.endswith(".depth"):
            choice.currentIndexChanged.connect(lambda _: self._follow(slot.partition(".")[0]))

    def _follow(self, role: str) -> None:
        """With a depth, choose the other of two, and the colour of its camera unless a camera without depth has it."""
        images, color = {image.name: image for image in self._found.images}, self.choices.get(f"{role}.color")
        depth = images.get(self.choices[f"{role}.depth"].currentData())
        others = [image for image in images.values() if image.kind == "depth" and image is not depth]
        other = self.choices["tactile.depth" if role == "proximity" else "proximity.depth"]
        if depth is not None and len(others) == 1 and not other.currentData():
            other.setCurrentIndex(other.findData(others[0].name))
        if color is None:
            return
        chosen, camera = images.get(color.currentData()), depth and depth.camera
        cameras = [image.camera for image in images.values() if image.kind == "depth"]
        own = [image.name for image in images.values() if image.kind == "color" and image.camera == camera]
        if chosen is None or chosen.camera in cameras:
            color.setCurrentIndex(color.findData(own[0] if own else ""))

    def _pixmap(self, topic: str) -> QPixmap:
        """Return the picture of a topic; none if it could not be read."""
        pixels = self._found.pictures.get(topic)
        if pixels is None:
            return QPixmap()
        height, width, _ = pixels.shape
        image = QImage(pixels.tobytes(), width, height, 3 * width, QImage.Format.Format_RGB888)
        return QPixmap.fromImage(image).scaled(_PICTURE_SIZE, Qt.AspectRatioMode.KeepAspectRatio)

    @property
    def topics(self) -> dict[str, str]:
        """The topic of each image that has one, and the file of each lens that the recording lacks."""
        chosen = {slot: box.currentData() for slot, box in self.choices.items() if box.currentData()}
        return chosen | {slot: str(path) for slot, path in self._lenses.items() if slot in self._lacking(chosen)}

    def _lacking(self, chosen: dict[str, str]) -> list[str]:
        """Return the slots of the lenses that no topic states."""
        without = {image.name for image in self._found.images if not image.info}
        return [f"{role}.info" for role in ("proximity", "tactile") if chosen.get(f"{role}.depth") in without]

    def _ask_lens(self) -> None:
        lacking = self._lacking(self.topics)
        left = [slot for slot in lacking if slot not in self._lenses]
        # once each has a file, all are asked for again
        take = partial(self._take_lens, (left or lacking)[0], self._lenses if left else {})
        self._dialogs.open_file("lens", "Open the file of a lens", LENS_FILES, take)

    def _take_lens(self, slot: str, others: dict[str, Path], path: Path) -> None:
        self._lenses = others | {slot: path}
        self._show()

    def _show(self) -> None:
        for slot, picture in self._pictures.items():
            topic = self.topics.get(slot, "")
            picture.setPixmap(self._pixmap(topic)) if topic else picture.setText("No image")
        depths = [self.topics.get(f"{role}.depth", "") for role in ("proximity", "tactile")]
        problem = ""
        if not depths[1]:
            problem = "Choose the depth of the tactile camera, which sees the membrane."
        elif depths[0] == depths[1]:
            problem = "One topic is chosen twice: choose another one for one camera."
        lacking = self._lacking(self.topics)
        without = [slot.partition(".")[0] for slot in lacking if slot not in self._lenses]
        if without and not problem:
            problem = f"The recording has no lens (camera_info) of the {without[0]} camera: choose a file of it."
        self.lens.setVisible(bool(lacking))
        self.note.say(problem, error=True)
        if not problem:
            alone = "" if depths[0] else "Without proximity depth this is a rig with a tactile camera only. "
            files = " and ".join(self._lenses[slot].name for slot in lacking)
            self.note.say(f"{alone}{files and f'Lens: {files}'}".strip())
        self._open.setEnabled(not problem)


class TopicsControl(QObject):
    """Looks into a recording before it is opened, and asks for its topics or its rig where these are unknown."""

    def __init__(
        self,
        parent: QWidget,
        dialogs: Dialogs,
        use: Callable[[str], object],
        give_up: Callable[[str, str], object],
    ) -> None:
        super().__init__(parent)
        self._window, self._dialogs, self._use, self._give_up = parent, dialogs, use, give_up
        self._name = ""
        self._job = Job(self, self._ask, lambda _: self._use(self._name))  # opening it tells what is wrong
        self.dialog: TopicsDialog | FolderRigDialog | None = None

    def open(self, name: str) -> None:
        """Call ``use`` with the name, topics added; or ``give_up`` with it and a sentence."""
        self._name = name
        self._job.start(lambda progress: images_without_rig(name) or topics_to_choose(name, progress))

    def close(self) -> None:
        self._job.stop()

    def _ask(self, found: Inspection | tuple[Path, tuple[str, ...]] | None) -> None:
        if isinstance(found, tuple):
            self._show(FolderRigDialog(*found, self._dialogs, self._window))
            return
        if found is None or not any(image.kind == "depth" for image in found.images):
            self._use(self._name)
            return
        self._show(TopicsDialog(self._name, found, self._dialogs, self._window))

    def _show(self, dialog: TopicsDialog | FolderRigDialog) -> None:
        self.dialog = dialog
        dialog.finished.connect(self._answered)
        dialog.open()

    def _answered(self, code: int) -> None:
        dialog, self.dialog = self.dialog, None
        if dialog is None:
            return
        if isinstance(dialog, FolderRigDialog):
            self._use(self._name) if code else self._give_up(self._name, "The folder has no rig, and was not opened.")
        elif code == QDialog.DialogCode.Accepted:
            self._use(f"{self._name}?{','.join(f'{slot}={topic}' for slot, topic in dialog.topics.items())}")
        else:
            self._give_up(self._name, "No topics were chosen; the recording was not opened.")
        dialog.deleteLater()
