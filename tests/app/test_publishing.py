"""Publishing in the mode *Record and run*, seen by a Foxglove client of another make."""

import json
import time

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QMenu

from fakes import FakeSource
from foxglove_client import FoxgloveClient
from hands import LEFT, show_source, type_into
from sockets import free_port, listening
from tactune.core.estimation.tilt import TiltEstimator


@pytest.fixture
def port():
    return free_port()


@pytest.fixture
def publishing(window, qtbot, port):
    """The controls of publishing, with a free port; nothing is published yet."""
    QTest.keyClick(window, Qt.Key.Key_F8)
    dialog = window.publishing.panel
    qtbot.waitUntil(dialog.isVisible)
    type_into(dialog.port, str(port), Qt.Key.Key_Tab)
    return dialog


def switch_on(dialog, qtbot, port):
    QTest.mouseClick(dialog.start, LEFT)
    qtbot.waitUntil(lambda: f"ws://127.0.0.1:{port}" in dialog.state.text())


def test_nothing_listens_until_it_is_started_and_after_it_was_stopped(publishing, window, qtbot, port):
    assert not listening()
    assert "Foxglove" in publishing.state.text() and "ROS 2" not in publishing.state.text()
    QTest.mouseClick(publishing.foxglove, LEFT, pos=QPoint(8, publishing.foxglove.height() // 2))
    assert not publishing.start.isEnabled() and "Tick" in publishing.state.text()
    QTest.mouseClick(publishing.foxglove, LEFT, pos=QPoint(8, publishing.foxglove.height() // 2))
    assert not window.status.publishing.isVisible()
    [menu] = [menu for menu in window.menuBar().findChildren(QMenu) if menu.title() == "C&onnect"]
    assert menu.actions() == [window.actions_.publish]
    switch_on(publishing, qtbot, port)
    assert listening() == {("tcp", "127.0.0.1", port)}
    assert not publishing.port.isEnabled()
    assert "0 clients" in publishing.state.text()
    assert window.status.publishing.text() == "Publishing, 0 clients"
    QTest.mouseClick(publishing.start, LEFT)
    qtbot.waitUntil(lambda: not listening())
    assert not window.status.publishing.isVisible()
    assert publishing.port.isEnabled()


def test_clients_get_what_the_window_shows_and_are_counted(publishing, window, qtbot, port):
    switch_on(publishing, qtbot, port)
    with FoxgloveClient(port) as client:
        client.subscribe(["/contact/patch", "/contact/tilt"])
        qtbot.waitUntil(lambda: "1 client," in publishing.state.text())
        assert window.status.publishing.text() == "Publishing, 1 client"
        window.worker.seek(5)
        seen = next(client.frames(["/contact/patch", "/contact/tilt"]))
        cloud, tilt = seen["/contact/patch"], seen["/contact/tilt"].vector
        qtbot.waitUntil(lambda: window.result.playback.index == 5)
        points = np.frombuffer(bytes(cloud.data), "<f4").reshape(-1, 3)
        assert np.array_equal(points, window.result.patch.points)
        assert len(points)
        patch = window.result.patch
        assert tilt.x == TiltEstimator(window.document.preset, patch.rig).estimate(patch).roll_rad
    qtbot.waitUntil(lambda: "0 clients" in publishing.state.text())


def test_a_new_window_remembers_the_settings_but_is_off(publishing, window, make_window, qtbot, port):
    type_into(publishing.host, "0.0.0.0", Qt.Key.Key_Tab)
    assert "without a password" in publishing.note.text()
    type_into(publishing.host, "localhost", Qt.Key.Key_Tab)
    assert publishing.note.text() == ""
    kept = json.loads(window.settings.text("publish"))
    assert (kept["port"], kept["host"]) == (port, "127.0.0.1"), "what was typed is kept without a start"
    QTest.mouseClick(publishing.start, LEFT)
    qtbot.waitUntil(lambda: bool(listening()))
    window.close_without_asking()
    qtbot.waitUntil(lambda: not listening())
    window.settings.sync()
    again = make_window()
    show_source(qtbot, again, FakeSource(), 3)
    assert not listening()
    assert not again.publishing.panel.start.isChecked()
    assert again.publishing.panel.port.value() == port
    assert again.publishing.panel.host.text() == "127.0.0.1"


def test_a_window_that_closes_while_publishing_starts_stops_listening(publishing, window, qtbot):
    QTest.mouseClick(publishing.start, LEFT)
    end = time.monotonic() + 60
    while not listening() and time.monotonic() < end:
        time.sleep(0.01)  # handles no events, so the window does not know yet that it listens
    assert listening()
    window.close_without_asking()
    qtbot.waitUntil(lambda: not listening())


def test_ros_2_with_its_domain_and_namespace(publishing, qtbot):
    QTest.keyClick(publishing.foxglove, Qt.Key.Key_Space)
    QTest.keyClick(publishing.ros2, Qt.Key.Key_Space)
    type_into(publishing.domain, "78", Qt.Key.Key_Tab)
    type_into(publishing.namespace, "1 finger", Qt.Key.Key_Tab)
    QTest.mouseClick(publishing.start, LEFT)
    qtbot.waitUntil(lambda: "no namespace of ROS 2" in publishing.state.text())
    assert not listening()
    type_into(publishing.namespace, "left", Qt.Key.Key_Tab)
    QTest.mouseClick(publishing.start, LEFT)
    qtbot.waitUntil(lambda: "ROS 2, domain 78, 127.0.0.1, /left: 0 clients" in publishing.state.text())
