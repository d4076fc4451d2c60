"""The table of records: sorted, ticked and selected by mouse and keys."""

from collections import namedtuple

import pytest
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtTest import QTest

from hands import LEFT, cells, shown
from tactune.widgets.basics.record_table import Column, RecordTable

Record = namedtuple("Record", "name error on")
COLUMNS = (
    Column("Used", lambda record: "", ticked=lambda record: record.on),
    Column("Name", lambda record: record.name),
    Column("Error", lambda record: record.error, decimals=1),
)


@pytest.fixture
def table(qtbot):
    """A table whose owner takes every tick over."""
    made = RecordTable(COLUMNS, "Records", key=lambda record: record.name, sortable=True)
    made.set_records([Record("a", 1.54, True), Record("b", float("nan"), False), Record("c", -0.25, True)])

    def take(ticked, on):
        made.set_records([it._replace(on=on) if it is ticked else it for it in made.records()])

    made.ticked.connect(take)
    return shown(qtbot, made, 400, 200)


def test_a_click_ticks_a_row_and_space_all_that_are_selected(table):
    def ticked():
        return "".join(record.name for record in table.records() if record.on)

    box = table.visualRect(table.model().index([row[1] for row in cells(table)].index("a"), 0))
    QTest.mouseClick(table.viewport(), LEFT, pos=QPoint(box.left() + 12, box.center().y()))
    assert ticked() == "c"
    table.setFocus()
    for keys, expected in (("b", "bc"), ("ab", "abc"), ("ab", "c"), ("bc", "bc")):
        table.select(keys)
        QTest.keyClick(table, Qt.Key.Key_Space)
        assert ticked() == expected


def test_what_is_not_known_is_sorted_before_all_numbers_and_a_selection_goes_with_its_record(table):
    chosen = []
    table.selectionEdited.connect(chosen.append)
    table.select(["c"])
    errors = ["–", "−0.2", "1.5"]
    for order, expected in zip(Qt.SortOrder, (errors, errors[::-1]), strict=True):
        table.sortByColumn(2, order)
        assert [row[2] for row in cells(table)] == expected
        assert table.selected_keys() == ("c",)
    table.set_records(table.records()[1:])
    assert table.selected_keys() == ("c",) and not chosen
    place = table.visualRect(table.model().index(1, 1)).center()
    QTest.mouseClick(table.viewport(), LEFT, pos=place)
    assert chosen[-1] == ("b",)
