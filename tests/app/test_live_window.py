"""The window with live cameras: stale frames are marked, missing cameras are named, and capture resumes by itself."""

import time

from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from tactune.app.worker import reading
from tactune.app.worker.processing import FrameProcessor
from tactune.app.worker.results import CloudName


def badges(window):
    return {str(name): view.badge.text() for name, view in window.views.views.items()}


def test_the_view_of_a_missing_camera_says_what_to_do_the_others_wait_and_all_marks_go(window, cameras, qtbot):
    cameras.faults["tactile"] = "missing"
    qtbot.waitUntil(lambda: badges(window)["tactile"] != "")
    said = badges(window)
    assert said["tactile"].startswith("Tactile camera D405 (serial d002) is not connected: plug it in.")
    assert "The last frame is shown." in said["tactile"]
    assert said["proximity"].startswith("Waiting for the tactile camera. The last frame is shown.")
    assert "plug it in" in said["patch"]
    assert all(pane.badge.text() == "old" for pane in window.strip.panes.values())
    assert window.views.views[CloudName.TACTILE].point_count() > 0
    assert window.views.views[CloudName.TACTILE].badge.accessibleName() == said["tactile"]
    assert window.status.state.text() == "No frames"
    cameras.faults.clear()
    cameras.release()
    qtbot.waitUntil(lambda: set(badges(window).values()) == {""})
    assert {pane.badge.text() for pane in window.strip.panes.values()} == {""}
    qtbot.waitUntil(lambda: window.result.frame.sequence == 1)


def test_a_frame_that_cannot_be_processed_is_said_once_and_the_next_ones_are_shown(window, cameras, qtbot, monkeypatch):
    tried, said = [], []
    window.worker.failed.connect(said.append)
    with monkeypatch.context() as broken:
        broken.setattr(FrameProcessor, "process", lambda *_, **__: tried.append(1) or 1 / 0)
        cameras.release()
        qtbot.waitUntil(lambda: window.messages.by_key.get("worker") is not None)
        for count in (2, 3, 4):
            cameras.release()
            qtbot.waitUntil(lambda count=count: len(tried) >= count)
        assert len(said) == 1
    cameras.release()
    qtbot.waitUntil(lambda: window.result.frame.sequence == len(cameras.given) - 1)
    qtbot.waitUntil(lambda: window.messages.by_key.get("worker") is None)


def test_pausing_by_key_holds_the_frame_and_says_nothing_of_old(window, cameras, qtbot):
    QTest.keyClick(window, Qt.Key.Key_Space)
    qtbot.waitUntil(lambda: not window.transport.state.playing)
    too_old_s = time.monotonic() + 1.2 * reading.STALE_AFTER_S
    qtbot.waitUntil(lambda: cameras.release() or time.monotonic() > too_old_s)
    assert window.result.frame.sequence == 0
    assert set(badges(window).values()) == {""}
    assert not window.transport.position.isEnabled() and not window.actions_.next.isEnabled()
    QTest.keyClick(window, Qt.Key.Key_Space)
    qtbot.waitUntil(lambda: window.result.frame.sequence == len(cameras.given) - 1 > 0)
