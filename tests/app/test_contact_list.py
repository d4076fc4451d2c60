"""The list of contacts in the panel."""

from __future__ import annotations

from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from fakes import at_rest
from hands import LEFT, cells, shows_preset_of_document, tolerance_slider


def test_the_contacts_are_listed_and_one_is_marked(window, qtbot):
    contacts = window.contacts
    assert contacts.section.collapsed
    assert window.result.rendered.contacts is None, "a folded list costs nothing"
    window.panel.ensureWidgetVisible(contacts.section.button)
    QTest.mouseClick(contacts.section.button, LEFT)
    qtbot.waitUntil(lambda: len(cells(contacts.table)) == 1)
    patch = window.result.patch
    (row,) = cells(contacts.table)
    x, y, z = (1e3 * value for value in patch.centroid_m)
    assert row == [f"{patch.area_mm2 / 100:.2f}", f"{x:.1f}", f"{y:.1f}", f"{z:.1f}"]
    window.panel.ensureWidgetVisible(contacts.table)
    cell = contacts.table.visualRect(contacts.table.model().index(0, 0)).center()
    QTest.mouseClick(contacts.table.viewport(), LEFT, pos=cell)
    u, v = patch.contacts[0].pixel
    assert f"({u}, {v})" in window.strip.readout.text()
    assert window.strip.panes["difference"].cross.isVisible()
    window.worker.seek(5)
    qtbot.waitUntil(lambda: at_rest(window, 5))
    assert float(cells(contacts.table)[0][0]) > float(row[0]), "the disc grows"
    tolerance_slider(window).setFocus()
    QTest.keyClick(tolerance_slider(window), Qt.Key.Key_Home)
    qtbot.waitUntil(lambda: shows_preset_of_document(window) and cells(contacts.table) == [])
    assert contacts.note.text() == "No contact"
