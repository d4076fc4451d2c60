"""Dialogs that do not block: each answer goes to a callback.

Without nested event loops the worker's results, timers and shutdown continue while a dialog is
open, and tests can answer with real keys.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from PyQt6.QtCore import QMimeData, QRect, QSize, Qt
from PyQt6.QtGui import QScreen
from PyQt6.QtWidgets import QAbstractButton, QApplication, QFileDialog, QLabel, QMessageBox, QWidget

from .controls import add_mnemonics

#: What a window manager may draw around a window.
_FRAME = QSize(16, 40)


class Memory(Protocol):
    """Texts by name that outlive the program, as `tactune.app.settings.Settings` keeps them."""

    def text(self, key: str, default: str = "") -> str:
        """Return a remembered text."""

    def set(self, key: str, value: str) -> None:
        """Remember a text."""


class Dialogs:
    """Opens dialogs over a window; those for files start in the folder last used for their ``kind``."""

    def __init__(self, parent: QWidget | None, memory: Memory, native: bool = True) -> None:
        self._parent, self._memory, self._native = parent, memory, native

    def over(self, parent: QWidget) -> Dialogs:
        return Dialogs(parent, self._memory, self._native)

    def ask_unsaved(self, name: str, save: Callable[[], object], discard: Callable[[], object]) -> None:
        """Ask whether to save or discard changes; Cancel calls nothing."""
        box = self._box("Not saved", f"Save the changes to “{name}”?", "Without saving, they are lost.")
        saving = box.addButton(QMessageBox.StandardButton.Save)
        discarding = box.addButton(QMessageBox.StandardButton.Discard)
        box.setDefaultButton(saving)
        _open(box, lambda clicked: save if clicked is saving else discard if clicked is discarding else None)

    def ask(self, title: str, question: str, details: str, yes: str, use: Callable[[], object]) -> None:
        """Ask before something is replaced or removed; the button ``yes`` calls ``use``, Cancel nothing."""
        box = self._box(title, question, details)
        agree = box.addButton(yes, QMessageBox.ButtonRole.AcceptRole)
        box.setDefaultButton(QMessageBox.StandardButton.Cancel)
        _open(box, lambda clicked: use if clicked is agree else None)

    def folder(self, kind: str) -> Path:
        remembered = Path(self._memory.text(f"folder/{kind}", str(Path.home())))
        return remembered if remembered.is_dir() else Path.home()

    def remember(self, kind: str, folder: Path) -> None:
        self._memory.set(f"folder/{kind}", str(folder))

    def open_file(self, kind: str, title: str, name_filter: str, use: Callable[[Path], object]) -> None:
        dialog = self._dialog(title, self.folder(kind), QFileDialog.FileMode.ExistingFile)
        dialog.setNameFilters([name_filter, "All files (*)"])
        self._run(kind, dialog, lambda paths: use(paths[0]))

    def open_files(self, kind: str, title: str, name_filters: list[str], use: Callable[[list[Path]], object]) -> None:
        dialog = self._dialog(title, self.folder(kind), QFileDialog.FileMode.ExistingFiles)
        dialog.setNameFilters([*name_filters, "All files (*)"])
        self._run(kind, dialog, use)

    def open_folder(self, kind: str, title: str, use: Callable[[Path], object]) -> None:
        dialog = self._dialog(title, self.folder(kind), QFileDialog.FileMode.Directory)
        dialog.setOption(QFileDialog.Option.ShowDirsOnly)
        self._run(kind, dialog, lambda paths: use(paths[0]))

    def save_file(
        self, kind: str, title: str, suggestion: str | Path, name_filters: list[str], use: Callable[[Path], object]
    ) -> None:
        """Ask where to save, starting with a name or a path; a name without suffix gets that of the chosen filter."""
        path = self.folder(kind) / suggestion
        dialog = self._dialog(title, path.parent, QFileDialog.FileMode.AnyFile)
        dialog.setAcceptMode(QFileDialog.AcceptMode.AcceptSave)
        dialog.setNameFilters(name_filters)

        def take_suffix(chosen: str) -> None:
            dialog.setDefaultSuffix(chosen.partition("*.")[2].partition(")")[0])

        take_suffix(f"*{path.suffix})" if path.suffix else name_filters[0])
        dialog.filterSelected.connect(take_suffix)
        dialog.selectFile(path.name)
        self._run(kind, dialog, lambda paths: use(paths[0]))

    def _box(self, title: str, question: str, details: str) -> QMessageBox:
        """Return a warning with the button Cancel, which Esc presses."""
        box = QMessageBox(QMessageBox.Icon.Warning, title, question, parent=self._parent)
        box.setInformativeText(details)
        for label in box.findChildren(QLabel):
            label.setTextFormat(Qt.TextFormat.PlainText)  # a name may look like markup
        box.addButton(QMessageBox.StandardButton.Cancel)
        box.setEscapeButton(QMessageBox.StandardButton.Cancel)
        return box

    def _dialog(self, title: str, folder: Path, mode: QFileDialog.FileMode) -> QFileDialog:
        dialog = QFileDialog(self._parent, title, str(folder))
        dialog.setOption(QFileDialog.Option.DontUseNativeDialog, not self._native)
        dialog.setFileMode(mode)
        return dialog

    def _run(self, kind: str, dialog: QFileDialog, use: Callable[[list[Path]], object]) -> None:
        def answered(result: int) -> None:
            chosen = [Path(name) for name in dialog.selectedFiles()]
            is_folder = dialog.fileMode() == QFileDialog.FileMode.Directory
            dialog.deleteLater()
            if result and chosen:
                self.remember(kind, chosen[0] if is_folder else chosen[0].parent)
                use(chosen)

        dialog.finished.connect(answered)
        dialog.open()


def _open(box: QMessageBox, answer: Callable[[QAbstractButton | None], Callable[[], object] | None]) -> None:

    def answered(_: int) -> None:
        use = answer(box.clickedButton())
        box.deleteLater()
        if use is not None:
            use()

    box.finished.connect(answered)
    add_mnemonics(box.buttons())
    box.open()


def local_files(data: QMimeData | None) -> list[Path]:
    return [] if data is None else [Path(url.toLocalFile()) for url in data.urls() if url.isLocalFile()]


def room_on(screen: QScreen) -> QRect:
    return screen.availableGeometry().adjusted(0, 0, -_FRAME.width(), -_FRAME.height())


def bring_up(window: QWidget) -> None:
    """Show a window no larger than the screen, or bring it to the front."""
    screen = window.screen()
    if screen is not None and not window.isVisible() and QApplication.platformName() != "offscreen":
        window.resize(window.size().boundedTo(room_on(screen).size()))
    window.show()
    window.raise_()
    window.activateWindow()
