"""Examples of contact: marked and painted by mouse and keys, kept on disk."""

from __future__ import annotations

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, QPointF, Qt
from PyQt6.QtGui import QWheelEvent
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication

from fakes import FakeSource
from hands import CONTROL, LEFT, drag_over, show_source, text_of
from printed_source import PrintedSource
from tactune.core.tuning.advice.example_file import load_example
from tactune.widgets.images.paint_image import CONTACT, NO_CONTACT, UNKNOWN

RIGHT = Qt.MouseButton.RightButton


def open_examples(qtbot, main):
    """Open the window by its key."""
    QTest.keyClick(main, Qt.Key.Key_L, CONTROL)
    qtbot.waitUntil(lambda: main.suggest.examples_window is not None and main.suggest.examples_window.isVisible())
    window = main.suggest.examples_window
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow)
    return window


@pytest.fixture
def window(main, qtbot):
    return open_examples(qtbot, main)


@pytest.fixture
def painted(window):
    """The window with the present frame, ready to paint."""
    QTest.mouseClick(window.paint, LEFT)
    return window


def within(shape, start, end, radius):
    """The pixels within a distance of a horizontal stroke."""
    v, u = np.mgrid[: shape[0], : shape[1]]
    return np.hypot(u - np.clip(u, start[0], end[0]), v - start[1]) <= radius


def test_one_click_marks_the_frame_as_untouched(main, window, qtbot):
    QTest.mouseClick(window.untouched, LEFT)
    [example] = main.suggest.examples.examples
    assert example.frame is main.result.frame
    assert example.contact is None
    assert "Untouched" in window.list.item(0).text()
    QTest.keyClick(window, Qt.Key.Key_Z, CONTROL)
    qtbot.waitUntil(lambda: main.suggest.examples.examples == ())


def test_the_brush_paints_and_erases_and_each_stroke_is_a_step(main, painted, qtbot):
    window = painted
    assert main.suggest.examples.examples == (), "nothing is known yet"
    start, end = (50, 60), (100, 60)
    drag_over(window.image, start, (80, 60), end)
    [example] = main.suggest.examples.examples
    shape, radius = example.contact.shape, window.image.radius
    assert example.contact[within(shape, start, end, radius - 1)].all()
    assert not example.contact[~within(shape, start, end, radius + 1)].any()
    assert (example.known == example.contact).all()

    QTest.mouseClick(window.values[NO_CONTACT], LEFT)
    drag_over(window.image, (50, 100), (60, 100))
    drag_over(window.image, (75, 60), (75, 61), button=RIGHT)
    drag_over(window.image, (55, 60), (55, 61), modifier=Qt.KeyboardModifier.ShiftModifier)
    labels = window.image.labels
    assert labels[100, 55] == NO_CONTACT
    assert labels[60, 75] == labels[60, 55] == UNKNOWN
    assert labels[60, 100] == CONTACT
    for steps in (4, 3):
        QTest.keyClick(window, Qt.Key.Key_Z, CONTROL)
        qtbot.waitUntil(lambda steps=steps: main.suggest.examples.undo_stack.index() == steps)
    assert window.image.labels[60, 75] == CONTACT


def test_the_wheel_and_brackets_size_the_brush(painted):
    window = painted
    before = window.image.radius
    viewport = window.image.view.viewport()
    place = QPointF(20, 20)
    wheel = QWheelEvent(
        place, QPointF(viewport.mapToGlobal(place)), QPoint(), QPoint(0, 120), Qt.MouseButton.NoButton,
        Qt.KeyboardModifier.NoModifier, Qt.ScrollPhase.NoScrollPhase, False,
    )  # fmt: skip
    QApplication.sendEvent(viewport, wheel)
    larger = window.image.radius
    assert larger > before
    assert window.brush_size.value() == larger
    QTest.keyClick(window.image, Qt.Key.Key_BracketLeft)
    assert window.image.radius < larger


def test_the_brush_paints_by_keys(painted):
    window = painted
    window.image.setFocus()
    for key in 5 * [Qt.Key.Key_Right] + 4 * [Qt.Key.Key_Down]:
        QTest.keyClick(window.image, key, Qt.KeyboardModifier.ShiftModifier)
    QTest.keyClick(window.image, Qt.Key.Key_Space)
    assert window.image.labels[40, 50] == CONTACT
    QTest.keyClick(window.image, Qt.Key.Key_Delete)
    assert (window.image.labels == UNKNOWN).all()


def test_known_objects_are_contact_inside_and_none_outside(painted):
    window = painted
    QTest.mouseClick(window.tools["disc"], LEFT)
    drag_over(window.image, (40, 60), (50, 60), (60, 60))
    QTest.mouseClick(window.tools["rectangle"], LEFT)
    drag_over(window.image, (100, 20), (120, 30), (130, 40))
    v, u = np.mgrid[:120, :160]
    disc = np.hypot(u - 40, v - 60)
    labels = window.image.labels
    assert (labels[disc < 18.5] == CONTACT).all()
    assert (labels[22:39, 102:129] == CONTACT).all()
    assert (labels[(disc > 21.5) & (u < 98)] == NO_CONTACT).all()
    assert (labels[44:, 85:] == NO_CONTACT).all()
    QTest.mouseClick(window.clear, LEFT)
    assert (window.image.labels == UNKNOWN).all()
    QTest.mouseClick(window.rest, LEFT)
    assert "Untouched" in window.list.item(0).text()


def test_the_patch_of_the_present_preset_is_outlined(main, painted, qtbot):
    overlay, view = painted.overlay, painted.image.view
    box = QPoint(8, overlay.height() // 2)
    QTest.mouseClick(overlay, LEFT, pos=box)
    assert not overlay.isChecked()
    plain = view.grab().toImage()
    QTest.mouseClick(overlay, LEFT, pos=box)
    qtbot.waitUntil(lambda: view.grab().toImage() != plain)
    QTest.mouseClick(overlay, LEFT, pos=box)
    assert view.grab().toImage() == plain


def test_examples_outlive_a_crash_and_a_restart(main, painted, qtbot, make_window, tmp_path):
    drag_over(painted.image, (50, 60), (70, 60))
    contact = main.suggest.examples.examples[0].contact
    files = tmp_path / "unsaved" / "examples"
    qtbot.waitUntil(
        lambda: [(load_example(file).contact == contact).all() for file in files.rglob("example-*.npz")] == [True]
    )
    other = make_window()  # while the first one is still there, as after a crash
    show_source(qtbot, other, PrintedSource(), 2)
    [example] = other.suggest.examples.examples
    assert (example.contact == contact).all()

    window = open_examples(qtbot, other)
    window.list.setFocus()
    QTest.keyClick(window.list, Qt.Key.Key_Delete)
    other.close_without_asking()
    qtbot.waitUntil(other.worker.isFinished)
    assert list(files.rglob("example-*.npz")) == []


def test_each_pair_of_cameras_has_its_examples(main, painted, qtbot):
    drag_over(painted.image, (50, 60), (70, 60))
    [example] = main.suggest.examples.examples
    show_source(qtbot, main, FakeSource(), 1)
    assert main.suggest.examples.examples == ()
    assert painted.list.count() == 0
    show_source(qtbot, main, PrintedSource(), 1)
    assert main.suggest.examples.examples == (example,)


def test_a_damaged_example_is_set_aside_with_a_sentence(main, window, qtbot, make_window, tmp_path):
    QTest.mouseClick(window.untouched, LEFT)
    files = tmp_path / "unsaved" / "examples"
    qtbot.waitUntil(lambda: len(list(files.rglob("example-*.npz"))) == 1)
    [file] = files.rglob("example-*.npz")
    file.write_bytes(file.read_bytes()[:1000])
    other = make_window()
    show_source(qtbot, other, PrintedSource(), 2)
    assert other.suggest.examples.examples == ()
    assert "the example cannot be read" in text_of(other.messages)
    assert file.with_suffix(".damaged").exists()
