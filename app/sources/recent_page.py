"""The page *Recent*: sources that were open before, each with a picture."""

from __future__ import annotations

from functools import partial

from PyQt6.QtCore import QSize, Qt
from PyQt6.QtGui import QColor, QIcon, QImage, QKeyEvent, QPainter, QPalette, QPixmap
from PyQt6.QtWidgets import QListWidget, QListWidgetItem, QWidget

from ...core.sources.registry import is_recording, missing_path
from ...widgets.basics.controls import push_button, wrapped_label
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from ..settings import Settings
from ..worker.jobs import Job
from .page import SourcePage
from .thumbnails import SIZE, Thumbnails

RECENT = "sources"
_MISSING = "There is nothing at {} any more: it was moved or deleted. Delete removes it from this list."
_NONE = "Sources that you open will be listed here, each with a picture."
_SIMULATOR = "sim:cup"


class RecentPage(SourcePage):
    """Lists the recent sources, newest first. Those that are gone are grey."""

    title = "Recent"

    def __init__(self, settings: Settings, thumbnails: Thumbnails) -> None:
        super().__init__()
        self._settings, self._thumbnails = settings, thumbnails
        self.list = QListWidget()
        self.list.setAccessibleName("Recent sources")
        self.list.setToolTip("Sources that were open before; double-click one to open it, Delete removes it")
        self.list.setIconSize(QSize(*SIZE))
        self.list.setWordWrap(True)
        self.list.setSpacing(4)
        self.list.setTextElideMode(Qt.TextElideMode.ElideMiddle)
        self.none = wrapped_label(_NONE)
        self.simulator = push_button("Open simulator", f"Open {_SIMULATOR}, a sensor that needs no cameras")
        self._empty = QWidget()
        vbox(self.none, hbox(self.simulator, STRETCH), STRETCH, within=self._empty, margins=0)
        vbox(self.list, self._empty, within=self, margins=0)
        self._job = Job(self)
        self._job.progress.connect(self._picture_made)
        self._fill()
        self.list.currentItemChanged.connect(lambda item, _: self._selected(item))
        self.list.itemActivated.connect(lambda _: self.activated.emit())
        self.simulator.clicked.connect(self._open_simulator)

    def show_name(self, name: str) -> bool:
        """Select a name if it is in the list."""
        found = next((item for item in self._items() if item.data(Qt.ItemDataRole.UserRole) == name), None)
        if found is not None:
            self.list.setCurrentItem(found)
        return found is not None

    def stop(self) -> None:
        """Make no more pictures."""
        self._job.stop()

    def come_up(self) -> None:
        """Choose what is selected, the newest at first."""
        if self.list.currentItem() is None:
            self.list.setCurrentRow(0)
        self._selected(self.list.currentItem())

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        """Remove the selected source from the list."""
        if event is not None and event.key() == Qt.Key.Key_Delete:
            self._remove()
            return
        super().keyPressEvent(event)

    def _fill(self) -> None:
        lacking = []
        for name in self._settings.recent(RECENT):
            missing = missing_path(name)
            item = QListWidgetItem(name)
            item.setData(Qt.ItemDataRole.UserRole, name)
            item.setToolTip(name)
            if missing is not None:
                item.setText(f"{name}\n{_MISSING.format(missing)}")
                item.setForeground(self.palette().color(QPalette.ColorGroup.Disabled, QPalette.ColorRole.Text))
                item.setToolTip(item.text())
            elif not self._thumbnails.path(name).exists() and is_recording(name):
                lacking.append(name)
            self._show_picture(item, gray=missing is not None)
            self.list.addItem(item)
        self._show_list()
        if lacking:
            self._job.start(partial(self._thumbnails.make, lacking))

    def _show_list(self) -> None:
        """Show the list; while it is empty, what it is for."""
        self.list.setVisible(self.list.count() > 0)
        self._empty.setVisible(self.list.count() == 0)

    def _open_simulator(self) -> None:
        self._choose(_SIMULATOR)
        self.activated.emit()

    def _picture_made(self, _share: float, name: str) -> None:
        for item in self._items():
            if item.data(Qt.ItemDataRole.UserRole) == name:
                self._show_picture(item)

    def _show_picture(self, item: QListWidgetItem, gray: bool = False) -> None:
        image = self._thumbnails.load(item.data(Qt.ItemDataRole.UserRole))
        if image is None:
            picture = QPixmap(*SIZE)
            picture.fill(QColor(128, 128, 128, 48))
        else:
            height, width = image.shape[:2]
            shown = QImage(image.tobytes(), width, height, 3 * width, QImage.Format.Format_RGB888)
            picture = QPixmap.fromImage(shown.copy())
        icon = _padded(picture)
        item.setIcon(QIcon(icon.pixmap(QSize(*SIZE), QIcon.Mode.Disabled)) if gray else icon)

    def _items(self) -> list[QListWidgetItem]:
        items = [self.list.item(row) for row in range(self.list.count())]
        return [item for item in items if item is not None]

    def _selected(self, item: QListWidgetItem | None) -> None:
        if item is None:
            self._choose("")
            return
        name = item.data(Qt.ItemDataRole.UserRole)
        missing = missing_path(name)
        self._choose(name, _MISSING.format(missing) if missing is not None else "")

    def _remove(self) -> None:
        item = self.list.currentItem()
        if item is not None:
            self._settings.remove_recent(RECENT, item.data(Qt.ItemDataRole.UserRole))
            self.list.takeItem(self.list.row(item))
            self._show_list()


def _padded(picture: QPixmap) -> QIcon:
    """Return a picture as an icon of the same width as all others, so that the names stand below each other."""
    whole = QPixmap(*SIZE)
    whole.fill(Qt.GlobalColor.transparent)
    painter = QPainter(whole)
    painter.drawPixmap((SIZE[0] - picture.width()) // 2, (SIZE[1] - picture.height()) // 2, picture)
    painter.end()
    return QIcon(whole)
