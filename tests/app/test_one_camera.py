"""A rig with a tactile camera only in the window: what it shows, what it leaves out, and how contact is found."""

from dataclasses import replace

import numpy as np
import pytest
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QPushButton

from fakes import FakeSource
from hands import LEFT, show_source
from tactune.app.worker.results import CloudName
from tactune.core import open_source
from tactune.core.rig.untouched import untouched_frame


@pytest.fixture(scope="module")
def bubble():
    """The rig, the untouched frame, and a press."""
    with open_source("sim:cup?press=medium&cameras=tactile") as source:
        return source.rig, untouched_frame(source), source.next_frame()


@pytest.fixture
def untouched_source(bubble):
    rig, untouched, frame = bubble
    frames = [untouched, *(replace(frame, sequence=number) for number in (1, 2, 3))]
    return FakeSource(rig=rig, frames=frames, name="bubble", untouched=untouched)


def press(qtbot, widget, text):
    """Wait until a button with this text is visible, and click it."""

    def shown():
        return [each for each in widget.findChildren(QPushButton) if each.text() == text and each.isVisible()]

    qtbot.waitUntil(lambda: bool(shown()))
    QTest.mouseClick(shown()[0], LEFT)


def patch_view(window):
    return window.views.views[CloudName.PATCH]


def test_the_button_in_the_empty_view_chooses_pressure_and_one_undo_takes_it_back(window, qtbot, untouched_source):
    window.panel.histograms["tolerance.t"].set_data([1.0, 1.0], [-0.1, 0.0, 0.1], 2)
    show_source(qtbot, window, untouched_source, 3)
    qtbot.waitUntil(lambda: "%" not in window.panel.histograms["tolerance.t"].caption())
    qtbot.waitUntil(lambda: "tactile camera only" in patch_view(window).notice.text())
    press(qtbot, patch_view(window), "Use the pressure test")
    qtbot.waitUntil(lambda: window.result.patch is not None and len(window.result.patch.points) > 0)
    assert window.document.preset.contact_test == "pressure"
    assert window.result.patch.pressure.force_mm2[2] < -1000
    assert window.messages.by_key.get("problem") is None
    window.worker.seek(0)
    qtbot.waitUntil(lambda: window.result.frame.sequence == 0 and len(window.result.patch.points) == 0)
    window.document.undo_stack.undo()
    assert window.document.preset.contact_test == "tolerance"
    qtbot.waitUntil(lambda: "tactile camera only" in patch_view(window).notice.text())
    window.document.undo_stack.redo()
    qtbot.waitUntil(lambda: "No contact yet" in patch_view(window).notice.text())


def test_what_a_source_does_not_have_goes_and_comes_back(window, qtbot, untouched_source, bubble):
    actions, strip = window.actions_, window.strip

    def tabs():
        return [strip.tabs.tabText(tab) for tab in range(4) if strip.tabs.isTabVisible(tab)]

    rig, _, frame = bubble
    gray = [replace(frame, sequence=n, proximity_color=np.zeros_like(frame.proximity_color)) for n in range(4)]
    show_source(qtbot, window, FakeSource(rig=rig, frames=gray), 3)
    qtbot.waitUntil(lambda: tabs() == ["Tactile"] and strip.panes["tactile"].isVisible())
    show_source(qtbot, window, untouched_source, 3)
    assert not window.views.views[CloudName.PROXIMITY].isVisible()
    qtbot.waitUntil(lambda: tabs() == ["Colour", "Tactile"])
    assert not window.panel.sections["alignment"].isVisible() and window.panel.one_camera.isHidden()
    for action in (actions.calibrate, actions.show_proximity):
        assert not action.isEnabled()
        assert "tactile camera only" in action.toolTip()

    window.views.enlarge(strip.panes["color"])  # an enlarged image and back
    window.views.back()
    assert not window.views.views[CloudName.PROXIMITY].isVisible()
    assert not strip.panes["difference"].isVisible()

    show_source(qtbot, window, FakeSource(), 3)
    qtbot.waitUntil(window.views.views[CloudName.PROXIMITY].isVisible)  # a frame may come before the news of its source
    assert len(tabs()) == 4
    assert window.panel.sections["alignment"].isVisible() and not window.panel.one_camera.isHidden()
    for action in (actions.calibrate, actions.show_proximity):
        assert action.isEnabled()
        assert "tactile camera only" not in action.toolTip()


def test_two_buttons_lead_from_a_recording_of_one_camera_to_a_patch(window, qtbot):
    window.open_source("sim:cup?press=medium&cameras=tactile")
    qtbot.waitUntil(lambda: window.result is not None and not window.result.source.rig.has_proximity)
    views = window.views.views
    qtbot.waitUntil(views[CloudName.PROXIMITY].isHidden)
    assert views[CloudName.TACTILE].isVisible()
    press(qtbot, patch_view(window), "Use the pressure test")
    assert window.document.preset.contact_test == "pressure"
    qtbot.waitUntil(lambda: window.result.preset.contact_test == "pressure" and "untouched" in window.result.problem)
    press(qtbot, patch_view(window), "Capture untouched frame")
    capture = window.set_up.untouched.work
    qtbot.waitUntil(capture.start.isVisible)
    capture.wanted = 3
    QTest.mouseClick(capture.start, LEFT)
    qtbot.waitUntil(lambda: not capture.busy and window.document.preset.untouched is not None, timeout=60_000)
    qtbot.waitUntil(lambda: window.result.patch is not None and len(window.result.patch.points) > 1000)
