"""The tabs Track and Tilt: a simulated cup is found and followed, its angles are shown; both are exported."""

import csv
import math
from concurrent.futures import ThreadPoolExecutor
from threading import Event

import numpy as np
import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from fakes import at_rest
from foxglove_client import FoxgloveClient
from hands import LEFT, show_source, type_into, type_path
from small_recordings import small_rig
from sockets import free_port
from tactune.core import PoseTracker
from tactune.core.estimation.object_mesh import simulated_mesh
from tactune.core.sources.presets import load_preset
from tactune.core.sources.registry import open_source
from tactune.core.sources.simulator.scenes import resolve_scene
from tactune.core.sources.simulator.simulator_source import SimulatorSource

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
def tab(qtbot, window, source, cup_file):
    """The tab beside a window that stands still at a frame in which the cup is pressed, with its mesh dropped on it."""
    window.document.new(load_preset("simulator"))
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
    assert tab.guide.text() == "Preparing the mesh of the object…"
    qtbot.waitUntil(lambda: tab.model.mesh.name == "cup")
    np.testing.assert_array_equal(tab.model.mesh.vertices_m, simulated_mesh(source.scene, source.name).vertices_m)


def test_the_cup_is_found_followed_exported_lost_and_found_again(qtbot, tab, source, tmp_path):
    drawn = tab.scene.point_count()
    QTest.mouseClick(tab.track_button, LEFT)
    qtbot.waitUntil(lambda: tab.tracked is not None)
    assert tab.track_button.isChecked()
    assert tab.scene.point_count() == drawn, "the model counts no points of the patch"
    assert [name for name, _ in tab.scene.header.entries][:2] == ["patch", "model"]
    assert tab.tracked.error.position_m < 0.002 and tab.tracked.error.angle_rad < np.radians(2.0)
    for index in (PRESSED + 1, PRESSED - 1):
        tab.main.worker.seek(index)
        qtbot.waitUntil(lambda index=index: at_rest(tab.main, index))
        qtbot.waitUntil(lambda index=index: tab.tracked.estimate.sequence == index)
        true = np.array(source.read(index).truth.T_proximity_object)
        assert abs(tab.tracked.estimate.T_proximity_object[2, 3] - true[2, 3]) < 0.001
    assert "mm" in tab.pose.text() and "±" in tab.pose.text()
    QTest.mouseClick(tab.export, LEFT)
    type_path(qtbot, tmp_path / "poses.csv")
    qtbot.waitUntil(lambda: tab.messages.by_key.get("done") is not None)
    rows = list(csv.DictReader((tmp_path / "poses.csv").read_text(encoding="utf-8").splitlines()))
    assert [int(row["sequence"]) for row in rows] == [PRESSED - 1, PRESSED, PRESSED + 1]
    assert float(rows[-1]["position_error_mm"]) < 2
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
            while True:
                progress(0.5)
        finally:
            ended.set()

    monkeypatch.setattr(PoseTracker, "find", search_for_ever)
    QTest.mouseClick(tab.track_button, LEFT)
    qtbot.waitUntil(tab.working.cancel.isVisible)
    QTest.mouseClick(tab.working.cancel, LEFT)
    qtbot.waitUntil(ended.is_set)
    qtbot.waitUntil(lambda: not tab.track_button.isChecked() and not tab.working.cancel.isVisible())
    assert tab.tracked is None


def poses_are_published_also_behind_another_tab(qtbot, tab, source):
    publishing = tab.main.publishing.panel
    port = free_port()
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


def opened(qtbot, window, source=None, index=3):
    show_source(qtbot, window, source or open_source("sim:cup?press=medium"), index)
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow)
    QTest.keyClick(window, Qt.Key.Key_F8, Qt.KeyboardModifier.ShiftModifier)
    analysis = window.analysis.window
    qtbot.waitExposed(analysis)
    tab = analysis.made["tilt"]
    qtbot.waitUntil(lambda: tab.shown is not None and tab.shown[0].frame.sequence == index)
    return tab


def test_shows_the_angles(qtbot, window):
    tab = opened(qtbot, window)
    alone = tab.shown[1]
    assert f"{math.degrees(alone.roll_sigma_rad):.2f}" in tab.roll.text()
    assert abs(alone.roll_rad) < 0.2 and 0 < alone.roll_sigma_rad < 0.05
    assert [name for name, _ in tab.cloud.header.entries] == ["patch", "fitted plane"]
    assert "noise" in tab.status.text()  # that of the rig was not measured


def test_a_preset_that_does_not_fit_leaves_no_angles_of_another_frame(qtbot, window):
    tab = opened(qtbot, window)
    assert tab.roll.text()
    assert window.document.edit("rig", small_rig(64).model_dump(mode="json"))
    qtbot.waitUntil(lambda: window.result.patch is None)
    qtbot.waitUntil(lambda: tab.shown is None)
    assert (tab.roll.text(), tab.axis.text()) == ("", "")
    assert tab.cloud.notice.text() == tab.status.text() == window.result.problem != ""


def test_rows_are_exported(qtbot, window, tmp_path):
    tab = opened(qtbot, window)
    first = tab.shown[1]
    window.worker.seek(4)
    qtbot.waitUntil(lambda: tab.shown[0].frame.sequence == 4)
    tab.save_to(tmp_path / "tilt.csv")
    qtbot.waitUntil(lambda: tab.messages.by_key.get("done") is not None)
    with (tmp_path / "tilt.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["frame"] for row in rows] == ["3", "4"]
    seconds, _ = tab.plot.getPlotItem().listDataItems()[0].getData()
    assert seconds[0] == 0.0, "the plot counts from the first frame shown"
    assert float(rows[1]["time_s"]) - float(rows[0]["time_s"]) == pytest.approx(seconds[1])
    assert float(rows[0]["roll_deg"]) == pytest.approx(math.degrees(first.roll_rad), abs=1e-3)
    assert float(rows[1]["roll_sigma_deg"]) > 0
