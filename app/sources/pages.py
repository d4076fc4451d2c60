"""Pages of the dialog *Open…*: what a page is, and the recent sources with files and folders, by their names."""

from __future__ import annotations

from pathlib import Path

from PyQt6.QtCore import Qt, pyqtSignal
from PyQt6.QtWidgets import QListWidget, QListWidgetItem, QWidget

from ...core.errors import SourceError
from ...core.sources.base import SourceKind
from ...core.sources.registry import missing_path, source_kinds
from ...widgets.basics.controls import named, push_button, wrapped_label
from ...widgets.basics.dialogs import Dialogs
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from ...widgets.basics.overlays import Notice
from ..settings import Settings


def recording_name(paths: list[Path]) -> str:
    """Return the name of the source that opens a folder, a file, or two files of two cameras."""
    if len(paths) == 1 and paths[0].is_dir():
        name = str(paths[0])
        folders = [kind for kind in source_kinds() if kind.needs == "folder" and kind.claim(name) is not None]
        return f"{folders[0].scheme if folders else 'folder'}:{name}"
    kinds = {path: _kind_of(path) for path in paths}
    kind = kinds[paths[0]]
    if kind is None or set(kinds.values()) != {kind}:
        names = ", ".join(path.name for path in paths)
        what = "is neither a preset (.json) nor a recording" if len(paths) == 1 else "are recordings of different kinds"
        endings = " ".join(pattern.removeprefix("*") for pattern in _patterns())
        raise SourceError(f"{names} {what} (a folder with rig.json, or a file {endings}); nothing was changed.")
    if len(paths) > kind.files:
        raise SourceError("Open one recording at a time, or the two .bag files of two cameras; nothing was changed.")
    return f"{kind.scheme}:{','.join(map(str, sorted(paths)))}"


def recording_filters() -> list[str]:
    """Return the filters of a file dialog, all recordings first."""
    return [
        f"Recordings ({' '.join(_patterns())})",
        *(f"{kind.title} ({kind.pattern})" for kind in _file_kinds()),
    ]


def _kind_of(path: Path) -> SourceKind | None:
    name = Path(path.name.lower())
    return next((kind for kind in _file_kinds() if any(map(name.match, kind.pattern.split()))), None)


def _patterns() -> list[str]:
    return [pattern for kind in _file_kinds() for pattern in kind.pattern.split()]


def _file_kinds() -> list[SourceKind]:
    return [kind for kind in source_kinds() if kind.needs == "file"]


RECENT = "sources"
_NOTHING = "Nothing yet: choose a file or a folder, or open the simulator"
_SIMULATOR = "sim:cup"


class SourcePage(QWidget):
    """Base of the pages: each offers sources of one kind, the chosen ``name`` and a ``note`` about it, or empty."""

    changed = pyqtSignal()  # name or note
    activated = pyqtSignal()  # open the choice
    title = ""

    def __init__(self) -> None:
        super().__init__()
        self.name = self.note = ""

    def come_up(self) -> None:
        """The page is shown."""

    def stop(self) -> None:
        """End what runs; the dialog is closed."""

    def _choose(self, name: str, note: str = "") -> None:
        self.name, self.note = name, note
        self.changed.emit()

    def _open(self, name: str) -> None:
        self._choose(name)
        self.activated.emit()


class FilesPage(SourcePage):
    """Asks for a file or folder, and lists the recent sources that are still there, newest first."""

    title = "Files and recent"

    def __init__(self, settings: Settings, dialogs: Dialogs) -> None:
        super().__init__()
        self._dialogs = dialogs.over(self)
        self.file = push_button("Choose fi&le…", "Choose a recording, or the two .bag files of two cameras")
        self.folder = push_button("Choose fol&der…", "Choose a recording stored as a folder of images")
        self.simulator = push_button("Open &simulator", f"Open {_SIMULATOR}, a sensor that needs no cameras")
        self.list = named(QListWidget(), "Recent sources", "Sources that were open before; double-click one to open it")
        self.list.setWordWrap(True)
        self.list.setSpacing(2)
        self.list.setTextElideMode(Qt.TextElideMode.ElideMiddle)
        buttons = hbox(self.file, self.folder, self.simulator, STRETCH)
        vbox(buttons, wrapped_label("Opened before:"), (self.list, 1), within=self, margins=8)
        self.list.addItems(name for name in settings.recent(RECENT) if missing_path(name) is None)
        Notice(self.list).set_text("" if self.list.count() else _NOTHING)
        self.list.currentItemChanged.connect(lambda item, _: self._selected(item))
        self.list.itemActivated.connect(lambda _: self.activated.emit())
        self.file.clicked.connect(
            lambda: self._dialogs.open_files("source", "Open a recording", recording_filters(), self._chosen)
        )
        self.folder.clicked.connect(
            lambda: self._dialogs.open_folder("source", "Open a recorded folder", lambda path: self._chosen([path]))
        )
        self.simulator.clicked.connect(lambda: self._open(_SIMULATOR))

    def come_up(self) -> None:
        if self.list.currentItem() is None:
            self.list.setCurrentRow(0)
        self._selected(self.list.currentItem())

    def _selected(self, item: QListWidgetItem | None) -> None:
        self._choose("" if item is None else item.text())

    def _chosen(self, paths: list[Path]) -> None:
        try:
            self._open(recording_name(paths))
        except SourceError as error:
            self._choose("", str(error))
