"""The list of contacts: the connected parts of the patch with area, place and depth."""

from __future__ import annotations

from typing import Any

from PyQt6.QtCore import QObject
from PyQt6.QtWidgets import QAbstractItemView

from ...core.model.patch import Contact
from ...widgets.basics.controls import CollapsibleSection, wrapped_label
from ...widgets.basics.layouts import vbox
from ...widgets.basics.record_table import Column, RecordTable
from ...widgets.images.image_strip import ImageStrip
from ...widgets.parameters.parameter_panel import ParameterPanel
from ..context import Context

#: The number of contacts listed; smaller ones are only counted.
LIMIT = 20
_ROWS_SEEN = 5


#: A row is the contact's place in the list, largest first, and the contact.
_COLUMNS = (
    Column("Area, cm²", lambda row: row[1].area_mm2 / 100, "Area across the optical axis", decimals=2, stretch=True),
    Column("x, mm", lambda row: 1e3 * row[1].centroid_m[0], "Centroid, to the right", decimals=1, stretch=True),
    Column("y, mm", lambda row: 1e3 * row[1].centroid_m[1], "Centroid, down", decimals=1, stretch=True),
    Column("Depth, mm", lambda row: 1e3 * row[1].centroid_m[2], "Mean distance", decimals=1, stretch=True),
)


class ContactList(QObject):
    """Fills a section of the panel with the contacts; the chosen one is marked in images and views."""

    def __init__(self, context: Context, panel: ParameterPanel, strip: ImageStrip) -> None:
        super().__init__(context)
        self._context, self._strip = context, strip
        self._contacts: tuple[Contact, ...] = ()
        self.section = CollapsibleSection("Contacts")
        self.table = RecordTable(
            _COLUMNS,
            "Contacts",
            "Connected parts of the patch, the largest first. Choose one to mark it in images and views.",
            key=lambda row: row[0],
        )
        self.table.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        self.table.setFixedHeight(self.table.full_height() + _ROWS_SEEN * (self.table.fontMetrics().height() + 6))
        self.note = wrapped_label()
        vbox(self.table, self.note, within=self.section.body, margins=(8, 4, 4, 4))
        panel.add_section("contacts", self.section)
        self.section.set_collapsed(True)
        self.table.selectionEdited.connect(self._mark)
        context.frameShown.connect(self._show_frame)

    def _show_frame(self) -> None:
        contacts = None if self._context.result is None else self._context.result.rendered.contacts
        if contacts is None or contacts is self._contacts:
            return
        self._contacts = contacts
        self.table.set_records(list(enumerate(contacts[:LIMIT])))
        rest = len(contacts) - LIMIT
        self.note.setText("No contact" if not contacts else f"and {rest:,} smaller ones" if rest > 0 else "")
        self.note.setVisible(bool(self.note.text()))

    def _mark(self, keys: tuple[Any, ...]) -> None:
        if keys and keys[0] < len(self._contacts):
            self._strip.point_at(*self._contacts[keys[0]].pixel)
