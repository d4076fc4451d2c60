"""The list of contacts: the connected parts of the patch with area, place and depth."""

from __future__ import annotations

from PyQt6.QtCore import QObject, Qt
from PyQt6.QtWidgets import QAbstractItemView, QHeaderView, QTableWidget, QTableWidgetItem

from ...core.errors import minus
from ...core.model.patch import Contact
from ...widgets.basics.controls import CollapsibleSection, read_only_table, wrapped_label
from ...widgets.basics.layouts import vbox
from ...widgets.images.image_strip import ImageStrip
from ...widgets.parameters.parameter_panel import ParameterPanel
from ..context import Context

#: The number of contacts listed; smaller ones are only counted.
LIMIT = 20
_ROWS_SEEN = 5
_COLUMNS = {
    "Area, cm²": "Area across the optical axis in square centimetres",
    "x, mm": "Centroid, to the right in the proximity camera's frame, in millimetres",
    "y, mm": "Centroid, down in the proximity camera's frame, in millimetres",
    "Depth, mm": "Centroid, mean distance from the proximity camera along its axis, in millimetres",
}


class ContactList(QObject):
    """Fills a section of the panel with the contacts, the largest first; a folded one costs nothing.

    The contact chosen in the table is marked in images and views, at its point nearest to the centroid.
    """

    def __init__(self, context: Context, panel: ParameterPanel, strip: ImageStrip) -> None:
        super().__init__(context)
        self._context, self._strip = context, strip
        self._contacts: tuple[Contact, ...] = ()
        self.section = CollapsibleSection("Contacts")
        self.table = QTableWidget(0, len(_COLUMNS))
        self.note = wrapped_label()
        self._lay_out()
        panel.add_section("contacts", self.section)
        self.section.set_collapsed(True)
        self.table.itemSelectionChanged.connect(self._mark)
        context.frameShown.connect(self._show_frame)

    def _lay_out(self) -> None:
        table = self.table
        columns, rows = read_only_table(
            table,
            "Contacts",
            "Connected parts of the patch, the largest first. Choose one to mark it in images and views.",
        )
        table.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        for column, (title, tip) in enumerate(_COLUMNS.items()):
            item = QTableWidgetItem(title)
            item.setToolTip(tip)
            table.setHorizontalHeaderItem(column, item)
        columns.setSectionResizeMode(QHeaderView.ResizeMode.Stretch)
        height = rows.defaultSectionSize()
        table.setFixedHeight(columns.sizeHint().height() + _ROWS_SEEN * height + 2 * table.frameWidth())
        vbox(table, self.note, within=self.section.body, margins=(8, 4, 4, 4))

    def _show_frame(self) -> None:
        result = self._context.result
        if result is None:
            return
        contacts = result.rendered.contacts
        if contacts is not None and contacts is not self._contacts:
            self._contacts = contacts
            self._list()

    def _list(self) -> None:
        shown = self._contacts[:LIMIT]
        self.table.setRowCount(len(shown))
        for row, contact in enumerate(shown):
            texts = (f"{contact.area_mm2 / 100:.2f}", *(minus(f"{1e3 * value:z.1f}") for value in contact.centroid_m))
            for column, text in enumerate(texts):
                item = QTableWidgetItem(text)
                item.setTextAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
                self.table.setItem(row, column, item)
        rest = len(self._contacts) - len(shown)
        self.note.setText("No contact" if not shown else f"and {rest:,} smaller ones" if rest else "")
        self.note.setVisible(bool(self.note.text()))

    def _mark(self) -> None:
        row = self.table.currentRow()
        if self.table.selectedItems() and row < len(self._contacts):
            self._strip.point_at(*self._contacts[row].pixel)
