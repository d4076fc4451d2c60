"""The page *Files and others*: a recording, a folder of images, or any other kind of source by its name."""

from __future__ import annotations

from pathlib import Path

from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QHeaderView, QLabel, QTableWidget, QTableWidgetItem

from ...core.errors import SourceError
from ...core.sources.registry import source_kinds
from ...widgets.basics.controls import push_button, read_only_table
from ...widgets.basics.dialogs import Dialogs
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from .page import SourcePage
from .paths import recording_filters, recording_name


class FilesPage(SourcePage):
    """Asks for a file or folder, and lists every kind of source with its form."""

    title = "Files and others"

    def __init__(self, dialogs: Dialogs) -> None:
        super().__init__()
        self._dialogs = dialogs.over(self)
        self.file = push_button("Choose fi&le…", "Choose a recording, or the two .bag files of two cameras")
        self.folder = push_button("Choose fol&der…", "Choose a recording stored as a folder of images")
        self.kinds = QTableWidget(0, 2)
        self.kinds.setHorizontalHeaderLabels(["Name", "What it opens"])
        tip = "All kinds of sources, also those of other packages; double-click one to begin its name"
        header, rows = read_only_table(self.kinds, "Kinds of sources", tip)
        header.setDefaultAlignment(Qt.AlignmentFlag.AlignLeft)
        header.setSectionResizeMode(0, QHeaderView.ResizeMode.ResizeToContents)
        header.setStretchLastSection(True)
        rows.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        for row, kind in enumerate(source_kinds()):
            self.kinds.insertRow(row)
            name = QTableWidgetItem(kind.form.partition("[")[0])
            name.setToolTip(kind.form)
            name.setData(Qt.ItemDataRole.UserRole, f"{kind.scheme}:")
            self.kinds.setItem(row, 0, name)
            self.kinds.setItem(row, 1, QTableWidgetItem(kind.description))
        buttons = hbox(self.file, self.folder, STRETCH)
        vbox(buttons, QLabel("Or type a name below:"), (self.kinds, 1), within=self, margins=0)
        self.file.clicked.connect(self._ask_file)
        self.folder.clicked.connect(self._ask_folder)
        self.kinds.cellActivated.connect(self._kind_chosen)

    def _kind_chosen(self, row: int, _column: int) -> None:
        name = self.kinds.item(row, 0)
        assert name is not None
        self._choose(name.data(Qt.ItemDataRole.UserRole))

    def _ask_file(self) -> None:
        self._dialogs.open_files("source", "Open a recording", recording_filters(), self._chosen)

    def _ask_folder(self) -> None:
        self._dialogs.open_folder("source", "Open a recorded folder", lambda path: self._chosen([path]))

    def _chosen(self, paths: list[Path]) -> None:
        try:
            self._choose(recording_name(paths))
        except SourceError as error:
            self._choose("", str(error))
