"""A simulated cup is found and tracked from frame to frame, by real mouse and key events."""

import socket
from concurrent.futures import ThreadPoolExecutor
from itertools import chain, repeat
from threading import Event

import numpy as np
import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from fakes import at_rest
from foxglove_client import FoxgloveClient
from hands import LEFT, show_source, type_into
from tactune.core import PoseTracker
from tactune.core.estimation.object_mesh import simulated_mesh
from tactune.core.sources.presets import load_preset
from tactune.core.sources.simulator.scenes import resolve_scene
from tactune.core.sources.simulator.source import SimulatorSource

PRESSED = 40


@pytest.fixture(scope="module")
def cup_file(tmp_path_factory):
    trimesh = pytest.importorskip("trimesh")
    mesh = simulated_mesh(resolve_scene("cup"), "cup")
    path = tmp_path_factory.mktemp("mesh") / "cup.stl"
    trimesh.Trimesh(1000 * mesh.vertices_m, mesh.triangles, process=False).export(path)
    return path


@pytest.fixture
def source():
    with SimulatorSource("cup") as made:
        yield made


@pytest.fixture
def tab(qtbot, make_window, source, cup_file):
    """The tab beside a window that stands still at a frame in which the cup is pressed, with its mesh dropped on it."""
    window = make_window(load_preset("simulator"))
    show_source(qtbot, window, source, PRESSED)
    QTest.keyClick(window, Qt.Key.Key_F8, Qt.KeyboardModifier.ControlModifier)
    analysis = window.analysis.window
    qtbot.waitExposed(analysis)
    made = analysis.made["track"]
    made.open_mesh(cup_file)
    qtbot.waitUntil(lambda: made.model is not None)
    analysis.activateWindow()
    qtbot.waitUntil(analysis.isActiveWindow)
    made.main = window
    return made


def test_a_mesh_is_opened_refused_or_taken_from_the_simulator(qtbot, tab, source, tmp_path):
    model = tab.model
    assert np.ptp(model.mesh.vertices_m[:, 0]) == pytest.approx(0.107, abs=0.002)
    assert "107 x 92 x 74 mm" in tab.messages.by_key["mesh"].sentence
    (tmp_path / "broken.stl").write_text("no mesh", encoding="ascii")
    tab.open_mesh(tmp_path / "broken.stl")
    qtbot.waitUntil(lambda: any("roken.stl" in sentence for sentence in tab.messages.sentences()))
    assert tab.model is model
    QTest.mouseClick(tab.simulated, LEFT)
    qtbot.waitUntil(lambda: tab.model.mesh.name == "cup")
    np.testing.assert_array_equal(tab.model.mesh.vertices_m, simulated_mesh(source.scene, source.name).vertices_m)


def test_the_cup_is_found_followed_lost_and_found_again(qtbot, tab, source):
    drawn = tab.scene.point_count()
    QTest.mouseClick(tab.track_button, LEFT)
    qtbot.waitUntil(lambda: tab.tracked is not None)
    assert tab.track_button.isChecked()
    assert tab.scene.point_count() == drawn, "the model counts no points of the patch"
    assert [name for name, _ in tab.scene.legend.entries][:2] == ["patch", "model"]
    assert tab.tracked.error.position_m < 0.002 and tab.tracked.error.angle_rad < np.radians(2.0)
    for index in (PRESSED + 1, PRESSED - 1):
        tab.main.worker.seek(index)
        qtbot.waitUntil(lambda index=index: at_rest(tab.main, index))
        qtbot.waitUntil(lambda index=index: tab.tracked.estimate.sequence == index)
        true = np.array(source.read(index).truth.T_proximity_object)
        assert abs(tab.tracked.estimate.T_proximity_object[2, 3] - true[2, 3]) < 0.001
    assert "mm" in tab.pose.text() and "±" in tab.pose.text()
    poses_are_published_also_behind_another_tab(qtbot, tab, source)
    tab.main.analysis.window.open_on("track")
    tab.main.worker.pause()
    tab.main.worker.seek(0)
    qtbot.waitUntil(lambda: tab.tracked.estimate.lost)
    assert tab.pose.text() == ""
    tab.main.worker.seek(PRESSED)
    qtbot.waitUntil(lambda: not tab.tracked.estimate.lost)


def test_a_search_can_be_given_up(qtbot, tab, monkeypatch):
    ended = Event()

    def search_for_ever(_tracker, _patch, progress):
        try:
            for share in chain([0.25], repeat(0.5)):
                progress(share)
                Event().wait(0.01)
        finally:
            ended.set()

    monkeypatch.setattr(PoseTracker, "find", search_for_ever)
    QTest.mouseClick(tab.track_button, LEFT)
    qtbot.waitUntil(tab.working.isVisible)
    QTest.mouseClick(tab.working.cancel, LEFT)
    qtbot.waitUntil(ended.is_set)
    qtbot.waitUntil(lambda: not tab.track_button.isChecked() and not tab.working.isVisible())
    assert tab.tracked is None


def poses_are_published_also_behind_another_tab(qtbot, tab, source):
    publishing = tab.main.publishing.panel
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    QTest.keyClick(tab.main, Qt.Key.Key_F8)
    type_into(publishing.port, str(port), Qt.Key.Key_Tab)
    QTest.mouseClick(publishing.start, LEFT)
    qtbot.waitUntil(lambda: str(port) in publishing.state.text())
    tab.main.analysis.window.open_on("tilt")
    topics = ["/contact/patch", "/object/pose", "/tf"]
    with FoxgloveClient(port) as client:

        def receive():
            client.subscribe(topics)
            return next(client.frames(topics))

        with ThreadPoolExecutor(1) as thread:  # the window goes on meanwhile: it orders the tracking of each frame
            received = thread.submit(receive)
            tab.main.worker.set_speed(0.1)  # a busy machine, too, shall still be within the press
            tab.main.worker.play()
            qtbot.waitUntil(received.done)
            tab.main.worker.set_speed(1.0)
        seen = received.result()
    pose = seen["/object/pose"].pose
    assert pose.pose.position.x == seen["/tf"].transforms[0].transform.translation.x
    true = source.read(PRESSED).truth.T_proximity_object
    assert np.hypot(pose.pose.position.x - true[0][3], pose.pose.position.y - true[1][3]) < 0.003
    assert np.linalg.eigvalsh(np.reshape(pose.covariance, (6, 6))).min() > 0
