"""A rig with a tactile camera only in the window: what it shows, what it leaves out, and how contact is found."""

import numpy as np
import pytest
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QPushButton

from fakes import FakeSource, tiny_rig
from hands import LEFT, show_source
from tactune.app.worker.results import CloudName
from tactune.core.model.frames import Rig, SensorFrame, Shot

DENT_M = 0.012


def dented(index, rig):
    """A flat membrane at 250 mm; from frame 1 on a disc is pressed towards the camera."""
    height, width = rig.tactile.intrinsics.shape
    v, u = np.mgrid[:height, :width]
    pressed = (np.hypot(u - width / 2, v - height / 2) < 12) & (index > 0)
    counts = np.rint(np.where(pressed, 0.25 - DENT_M, 0.25) / rig.tactile.depth_unit_m).astype(np.uint16)
    color = np.full((height, width, 3), 90, np.uint8)
    return SensorFrame.of_shots(rig, index, None, Shot(counts, color, index / 30))


def one_camera(**options):
    rig = Rig.of_one_camera(tiny_rig().tactile)
    return FakeSource(rig=rig, make=dented, name="bubble", **options)


@pytest.fixture
def untouched_source():
    return one_camera(untouched=dented(0, Rig.of_one_camera(tiny_rig().tactile)))


def press(qtbot, widget, text):
    """Wait until a button with this text is visible, and click it."""

    def shown():
        return [each for each in widget.findChildren(QPushButton) if each.text() == text and each.isVisible()]

    qtbot.waitUntil(lambda: bool(shown()))
    QTest.mouseClick(shown()[0], LEFT)


def patch_view(window):
    return window.views.views[CloudName.PATCH]


def test_the_button_in_the_empty_view_chooses_dent_and_one_undo_takes_it_back(window, qtbot, untouched_source):
    show_source(qtbot, window, untouched_source, 3)
    qtbot.waitUntil(lambda: "tactile camera only" in patch_view(window).message())
    press(qtbot, patch_view(window), "Use the dent test")
    qtbot.waitUntil(lambda: window.result.patch is not None and len(window.result.patch.points) > 0)
    assert window.document.preset.contact_test == "dent"
    nearer = np.isclose(window.result.patch.points[:, 2], 0.25 - DENT_M, atol=2e-4)
    assert nearer.mean() > 0.8  # the average over neighbours blurs the edge of the disc
    assert window.messages.message("problem") is None
    window.worker.seek(0)
    qtbot.waitUntil(lambda: window.result.frame.sequence == 0 and len(window.result.patch.points) == 0)
    window.document.undo_stack.undo()
    assert window.document.preset.contact_test == "tolerance"


def test_views_and_actions_of_two_cameras_go_and_come_back(window, qtbot, untouched_source):
    actions, strip = window.actions_, window.strip
    show_source(qtbot, window, untouched_source, 3)
    assert not window.views.views[CloudName.PROXIMITY].isVisible()
    assert [strip.tabs.tabText(tab) for tab in range(4) if strip.tabs.isTabVisible(tab)] == ["Colour", "Tactile"]
    assert not window.panel.sections["alignment"].isVisible()
    for action in (actions.calibrate, actions.show_proximity):
        assert not action.isEnabled()
        assert "tactile camera only" in action.toolTip()

    window.views.enlarge(strip.panes["color"])  # an enlarged image and back
    window.views.back()
    assert not window.views.views[CloudName.PROXIMITY].isVisible()
    assert not strip.panes["difference"].isVisible()

    show_source(qtbot, window, FakeSource(), 3)
    assert window.views.views[CloudName.PROXIMITY].isVisible()
    assert all(strip.tabs.isTabVisible(tab) for tab in range(4))
    assert window.panel.sections["alignment"].isVisible()
    for action in (actions.calibrate, actions.show_proximity):
        assert action.isEnabled()
        assert "tactile camera only" not in action.toolTip()


def test_two_buttons_lead_from_a_recording_of_one_camera_to_a_patch(window, qtbot):
    window.open_source("sim:cup?press=medium&cameras=tactile")
    qtbot.waitUntil(lambda: window.result is not None and not window.result.source.rig.has_proximity)
    views, actions = window.views.views, window.actions_
    qtbot.waitUntil(views[CloudName.PROXIMITY].isHidden)
    assert views[CloudName.TACTILE].isVisible()
    assert not actions.show_proximity.isEnabled()
    assert not actions.calibrate.isEnabled()
    press(qtbot, patch_view(window), "Use the dent test")
    assert window.document.preset.contact_test == "dent"
    qtbot.waitUntil(lambda: window.result.preset.contact_test == "dent" and "untouched" in window.result.problem)
    press(qtbot, patch_view(window), "Capture untouched frame")
    capture = window.set_up.untouched.work
    qtbot.waitUntil(capture.start.isVisible)
    capture.wanted = 3
    QTest.mouseClick(capture.start, LEFT)
    qtbot.waitUntil(lambda: not capture.busy and window.document.preset.untouched is not None, timeout=60_000)
    qtbot.waitUntil(lambda: window.result.patch is not None and len(window.result.patch.points) > 1000)
