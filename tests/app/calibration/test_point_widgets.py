"""The point image, the loupe, the table and the small plots, by real events."""

import numpy as np
import pyqtgraph as pg
import pytest
from PyQt6.QtCore import QPointF, Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication

from pairs import pair_at
from tactune.app.calibration.points_page import PointRow, PointTable
from tactune.core.calibration.report import PairQuality
from tactune.widgets.images.marks import Mark
from tactune.widgets.images.point_image import PointImage

LEFT = Qt.MouseButton.LeftButton
PLAIN = Qt.KeyboardModifier.NoModifier


@pytest.fixture
def image(qtbot):
    pg.setConfigOptions(mouseRateLimit=-1)
    made = PointImage("Left")
    qtbot.addWidget(made)
    made.resize(640, 500)
    pixels = np.zeros((120, 160, 4), np.uint8)
    pixels[..., 3] = 255
    made.set_image(pixels)
    made.show()
    qtbot.waitExposed(made)
    QApplication.processEvents()
    return made


def test_a_click_places_a_point_to_a_fraction_of_a_pixel(image, qtbot):
    image.zoom(4)
    QApplication.processEvents()
    target = image.screen_place(80.5, 60.25).toPoint()
    with qtbot.waitSignal(image.placed) as caught:
        QTest.mouseClick(image.view.viewport(), LEFT, PLAIN, target)
    assert caught.args[:2] == pytest.approx(image.image_place(QPointF(target)))
    assert caught.args[:2] == pytest.approx((80.5, 60.25), abs=0.1)
    assert image.hasFocus()


def test_a_drag_on_free_ground_pans_and_places_nothing(image, qtbot):
    image.zoom(2)
    QApplication.processEvents()
    seen = image.box.viewRect().center().x()
    viewport = image.view.viewport()
    start = image.screen_place(80, 60).toPoint()
    with qtbot.assertNotEmitted(image.placed):
        QTest.mousePress(viewport, LEFT, PLAIN, start)
        for step in (10, 30, 60):
            QTest.mouseMove(viewport, start + start.__class__(step, 0))
        QTest.mouseRelease(viewport, LEFT, PLAIN, start + start.__class__(60, 0))
    assert image.box.viewRect().center().x() < seen - 5


def test_a_mark_is_taken_hold_of_and_keeps_its_grip(image, qtbot):
    image.set_marks([Mark("7", 40.0, 30.0), Mark("8", 100.0, 90.0)])
    viewport = image.view.viewport()
    moves = []
    image.dragged.connect(lambda *args: moves.append(args))
    grip = image.screen_place(40, 30).toPoint() + QPointF(3, -2).toPoint()
    with qtbot.waitSignal(image.pressed) as pressed:
        QTest.mousePress(viewport, LEFT, PLAIN, grip)
    assert pressed.args[0] == "7"
    goal = image.screen_place(60, 50).toPoint() + QPointF(3, -2).toPoint()
    QTest.mouseMove(viewport, goal)
    QTest.mouseRelease(viewport, LEFT, PLAIN, goal)
    key, u, v, done = moves[-1]
    assert (key, done) == ("7", True)
    assert (u, v) == pytest.approx((60, 50), abs=0.5)


@pytest.mark.parametrize(
    ("key", "modifier", "signal", "arguments"),
    [
        (Qt.Key.Key_Left, PLAIN, "nudged", (-1.0, 0.0)),
        (Qt.Key.Key_Up, Qt.KeyboardModifier.ShiftModifier, "nudged", (0.0, -0.1)),
        (Qt.Key.Key_Delete, PLAIN, "deleteRequested", ()),
        (Qt.Key.Key_Return, PLAIN, "acceptRequested", ()),
        (Qt.Key.Key_Space, PLAIN, "acceptRequested", ()),
        (Qt.Key.Key_Escape, PLAIN, "cancelRequested", ()),
    ],
)
def test_keys_nudge_and_ask(image, qtbot, key, modifier, signal, arguments):
    with qtbot.waitSignal(getattr(image, signal)) as caught:
        QTest.keyClick(image, key, modifier)
    assert tuple(caught.args) == pytest.approx(arguments)


ROWS = [
    PointRow(pair_at(1, (1, 2), (3, 4), tactile_depth_m=0.3), PairQuality("1", True, 0.1, 0.2, 0.14)),
    PointRow(pair_at(2, (5, 6), (7, 8), enabled=False), PairQuality("2")),
    PointRow(
        pair_at(3, (9, 2), (3, 4), tactile_depth_m=0.29), PairQuality("3", True, 3.0, 4.0, 3.1), "look again", True
    ),
]


@pytest.fixture
def table(qtbot):
    made = PointTable()
    qtbot.addWidget(made)
    made.resize(1100, 200)
    made.set_records(ROWS)
    made.show()
    return made


def cell(table, row, column, role=Qt.ItemDataRole.DisplayRole):
    model = table.model()
    return model.data(model.index(row, column), role)


def test_the_table_shows_the_worst_first_and_dashes(table):
    assert [cell(table, row, 0) for row in range(3)] == ["3", "1", "2"]
    assert [cell(table, 0, column) for column in (2, 3, 5)] == ["5.00", "3.10", "look again"]
    assert (cell(table, 1, 4), cell(table, 2, 4), cell(table, 2, 2)) == ("300.0", "–", "–")
    assert cell(table, 0, 3, Qt.ItemDataRole.BackgroundRole) is not None
    assert cell(table, 1, 3, Qt.ItemDataRole.BackgroundRole) is None
