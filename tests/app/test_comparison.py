"""Two presets compared: their patches, and everything that a person does with mouse and keys."""

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtTest import QTest

from fakes import HEIGHT, tiny_frame, tiny_rig
from hands import (
    CONTROL,
    LEFT,
    cells,
    drag_slider,
    image_position,
    shows_preset_of_document,
    tolerance_slider,
    type_path,
)
from tactune.app.document.comparison import Side
from tactune.app.window.comparison import compared_times
from tactune.app.worker.playback import PlaybackState
from tactune.app.worker.processing import FrameProcessor
from tactune.app.worker.results import SourceInfo, Wanted
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.preset import Preset
from tactune.core.preset.file import save_preset

ALT = Qt.KeyboardModifier.AltModifier
RIG = tiny_rig()
INFO = SourceInfo("tiny", RIG, 8, 30.0)


def assert_same(patch, expected):
    assert patch.points.tobytes() == expected.points.tobytes()
    assert (patch.provenance == expected.provenance).all()
    assert (patch.mask == expected.mask).all()
    assert patch.averaged_frames == expected.averaged_frames


# The worker's part


def test_both_sides_are_bit_identical_with_a_pipeline_of_their_own(preset):
    """Presets that average frames get every frame once and in order, whichever side they are on."""
    averaging = Preset().with_values({"membrane.frames": 4, "membrane.bias": False})
    shorter = averaging.with_value("membrane.frames", 2)
    a, b = Side("A", averaging), Side("B", shorter)
    alone = [ContactPipeline(averaging, RIG), ContactPipeline(shorter, RIG)]
    processor = FrameProcessor()
    for index in range(6):
        frame = tiny_frame(index, RIG)
        sides = (a, b) if index != 3 else (b, a)
        result = processor.process(INFO, frame, preset, Wanted(), PlaybackState(index), compared=sides)
        again = processor.process(INFO, frame, preset, Wanted(), PlaybackState(index), compared=sides)
        patches = [pipeline.process(frame) for pipeline in alone]
        by_name = {side.side.name: side for side in (result.compared.a, result.compared.b)}
        assert_same(by_name["A"].patch, patches[0])
        assert_same(by_name["B"].patch, patches[1])
        assert_same(result.patch, ContactPipeline(preset, RIG).process(frame))
        assert again.compared.a.times_ms == result.compared.a.times_ms, "a frame counts once"
        assert len(by_name["A"].times_ms) == index, "the first frame, for which tables are made, does not count"
    assert by_name["A"].patch.averaged_frames == 4
    assert processor.process(INFO, frame, preset, Wanted(), PlaybackState()).compared is None


def test_a_side_that_does_not_fit_the_rig_says_why_and_the_other_one_is_shown(preset):
    wrong = preset.model_copy(update={"rig": tiny_rig(width=32)})
    sides = Side("Present", preset), Side("Wrong", wrong)
    compared = FrameProcessor().process(INFO, tiny_frame(3, RIG), preset, Wanted(), PlaybackState(), compared=sides)
    compared = compared.compared
    assert len(compared.a.patch.points) > 0
    assert compared.b.patch is None
    assert "32" in compared.b.problem


def test_times_that_cannot_be_told_apart_are_marked_and_stay_their_own():
    assert compared_times([1, 2, 3, 4, 5], [2, 3, 4, 5, 6]) == ("≈ 3.0 ms", "≈ 4.0 ms")
    assert compared_times([1, 2, 3, 4, 5], [7, 8, 9, 10, 11]) == ("3.0 ms", "9.0 ms")


# The window


@pytest.fixture
def edited(window, qtbot):
    """A window whose t was raised from 0.03 to 0.1, so that more is in contact than was saved."""
    window.document.edit("tolerance.t", 0.1)
    qtbot.waitUntil(lambda: shows_preset_of_document(window))
    return window


@pytest.fixture
def compared(edited, qtbot):
    """The same window while it compares the preset as opened (A) with the present one (B)."""
    QTest.keyClick(edited, Qt.Key.Key_B, CONTROL)
    qtbot.waitUntil(lambda: edited.result.compared is not None)
    return edited


def test_what_changed_since_save_from_the_menu(edited, qtbot):
    bar = edited.menuBar()
    [entry] = [entry for entry in bar.actions() if entry.text() == "&Edit"]
    QTest.mouseClick(bar, LEFT, pos=bar.actionGeometry(entry).center())
    menu = entry.menu()
    QTest.mouseClick(menu, LEFT, pos=menu.actionGeometry(edited.actions_.compare).center())
    qtbot.waitUntil(lambda: edited.result.compared is not None)
    shown, panel = edited.result.compared, edited.comparison
    assert (shown.a.side.name, shown.b.side.name) == ("Saved", "Present")
    assert len(shown.b.patch.points) > len(shown.a.patch.points)
    assert panel.isVisible()
    assert cells(panel.table) == [["Tolerance t", "3 %", "10 %"]]
    assert panel.numbers["Points", 0].text() == f"{len(shown.a.patch.points):,}"
    assert panel.numbers["Area", 1].text() == f"{shown.b.area_mm2:,.0f} mm²"
    assert edited.result.patch is shown.b.patch, "other windows go on with the present preset"


def shares(window):
    """Where the wipe stands in each view and image, as a share of its width."""
    found = [view.canvas.grip.wipe.share for view in window.views.views.values()]
    return found + [pane.view.grip.wipe.share for pane in window.strip.panes.values()]


def test_drag_the_wipe_in_a_view_or_an_image_and_all_others_follow(compared, qtbot):
    views = compared.views.views
    canvas = views["tactile"].findChild(object, "canvas")
    width, height = canvas.width(), canvas.height()
    QTest.mousePress(canvas, LEFT, pos=QPoint(width // 2, height // 3))
    QTest.mouseMove(canvas, QPoint(width // 4, height // 3))
    QTest.mouseRelease(canvas, LEFT, pos=QPoint(width // 4, height // 3))
    assert shares(compared) == pytest.approx([0.25] * len(shares(compared)), abs=0.02)
    QTest.keyClick(compared, Qt.Key.Key_Right, ALT)
    assert views["patch"].canvas.grip.wipe.share == pytest.approx(0.3, abs=0.02)
    QTest.keyClick(compared, Qt.Key.Key_Left, ALT)
    QTest.keyClick(compared, Qt.Key.Key_Left, ALT)
    assert views["patch"].canvas.grip.wipe.share == pytest.approx(0.2, abs=0.02)
    pane = compared.strip.panes["color"]
    viewport, line = pane.view.viewport(), image_position(pane, pane.split(), HEIGHT // 2).toPoint()
    QTest.mousePress(viewport, LEFT, pos=line)
    for step in (10, 20, 30):
        QTest.mouseMove(viewport, line + QPoint(step, 0))
    QTest.mouseRelease(viewport, LEFT, pos=line + QPoint(30, 0))
    assert shares(compared) == pytest.approx([0.2 + 30 / viewport.width()] * len(shares(compared)), abs=0.03)
    patches = compared.result.compared
    assert views["patch"].cloud() is patches.a.rendered.clouds["patch"]
    assert views["patch"].canvas.right is patches.b.rendered.clouds["patch"]


def test_one_key_shows_a_then_b_then_the_wipe_again(compared):
    view, modes = compared.views.views["patch"], compared.comparison.modes
    points = [len(side.patch.points) for side in (compared.result.compared.a, compared.result.compared.b)]
    assert modes["wipe"].isChecked()
    for mode, share, count in (("A", 1.0, points[0]), ("B", 0.0, points[1]), ("wipe", 0.5, points[0])):
        QTest.keyClick(compared, Qt.Key.Key_C)
        assert modes[mode].isChecked()
        assert view.canvas.grip.wipe.share == share
        assert view.point_count() == count


def test_the_present_side_follows_a_slider(compared, qtbot):
    drag_slider(tolerance_slider(compared), 0.8, 0.7, 0.5)
    qtbot.waitUntil(lambda: shows_preset_of_document(compared))
    shown, present = compared.result.compared, compared.document.preset
    assert shown.b.side.preset is present
    assert compared.context.comparison.sides[1].preset is present
    assert shown.a.side.preset.tolerance.t == 0.03
    assert cells(compared.comparison.table)[0][2] == f"{100 * present.tolerance.t:g} %"


def test_use_a_is_one_step_and_ends_the_comparison(compared, qtbot):
    before = compared.document.preset
    assert not compared.comparison.use[1].isEnabled(), "B is the present preset already"
    QTest.mouseClick(compared.comparison.use[0], LEFT)
    assert compared.document.preset.tolerance.t == 0.03
    assert compared.document.undo_stack.undoText() == "Use Saved"
    qtbot.waitUntil(lambda: shows_preset_of_document(compared) and compared.result.compared is None)
    assert not compared.comparison.isVisible()
    assert compared.views.views["patch"].canvas.grip.wipe is None
    QTest.keyClick(compared, Qt.Key.Key_Z, CONTROL)
    assert compared.document.preset == before


def test_a_shipped_preset_and_a_file_can_be_compared(compared, qtbot, tmp_path):
    document, box = compared.document, compared.comparison.boxes[0]

    def choose(name):
        box.setFocus()
        QTest.keyClick(box, Qt.Key.Key_Space)
        qtbot.waitUntil(box.view().isVisible)
        row = box.findText(name)
        assert row >= 0, f"{name} is among {[box.itemText(index) for index in range(box.count())]}"
        box.view().setCurrentIndex(box.model().index(row, 0))
        QTest.keyClick(box.view(), Qt.Key.Key_Return)

    def side():
        return compared.result.compared.a.side

    choose("Shipped: default")
    qtbot.waitUntil(lambda: side().name == "Shipped: default")
    assert side().preset.contact_test == "membrane"
    file = tmp_path / "other.json"
    save_preset(document.preset.with_value("tolerance.t", 0.07), file)
    choose("File…")
    type_path(qtbot, file)
    qtbot.waitUntil(lambda: side().name == "other.json")
    assert side().preset.tolerance.t == 0.07
    assert box.currentText() == "other.json"


def test_pointing_at_an_image_reads_the_side_under_the_mouse(compared, qtbot):
    strip = compared.strip
    shown = compared.result.compared
    v, u = np.argwhere(shown.b.patch.mask & ~shown.a.patch.mask)[0]
    strip.setFocus()
    strip.panes["color"].hovered.emit(int(u), int(v))
    for share, letter, verdict in ((1.0, "A", "Dropped"), (0.0, "B", "Kept")):
        compared.comparison.move_wipe(share)
        assert compared.status.readout.text().startswith(letter)
        assert verdict in compared.status.readout.text()
