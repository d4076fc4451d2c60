"""A rig with a tactile camera only in the window: no empty view, and buttons that lead to a patch."""

from __future__ import annotations

from PyQt6.QtTest import QTest

from hands import LEFT
from tactune.app.worker.results import CloudName


def test_two_buttons_lead_from_a_recording_of_one_camera_to_a_patch(window, qtbot):
    window.open_source("sim:cup?press=medium&cameras=tactile")
    qtbot.waitUntil(lambda: window.result is not None and not window.result.source.rig.has_proximity)
    views, actions = window.views.views, window.actions_
    qtbot.waitUntil(views[CloudName.PROXIMITY].isHidden)
    assert views[CloudName.TACTILE].isVisible()
    assert not actions.show_proximity.isEnabled()
    assert not actions.calibrate.isEnabled()
    offer = views[CloudName.PATCH]._notice.button
    qtbot.waitUntil(offer.isVisible)
    QTest.mouseClick(offer, LEFT)
    assert window.document.preset.contact_test == "dent"
    qtbot.waitUntil(lambda: window.result.preset.contact_test == "dent" and "untouched" in window.result.problem)
    qtbot.waitUntil(offer.isVisible)
    QTest.mouseClick(offer, LEFT)
    qtbot.waitUntil(lambda: window.untouched.window is not None and window.untouched.window.isVisible())
    capture = window.untouched.window.panel
    capture.wanted = 3
    QTest.mouseClick(capture.start, LEFT)
    qtbot.waitUntil(lambda: not capture.busy and window.document.preset.untouched is not None, timeout=60_000)
    qtbot.waitUntil(lambda: window.result.patch is not None and len(window.result.patch.points) > 1000)
