"""A simulated cup is found, placed by hand, tracked from frame to frame and exported, by real mouse and key events."""

from __future__ import annotations

import csv
import socket
from collections.abc import Callable
from itertools import chain, repeat
from threading import Event

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from fakes import at_rest
from foxglove_client import FoxgloveClient
from hands import CONTROL_SHIFT, LEFT, drop, show_source, type_into, type_path
from tactune.app.analysis import track_tab
from tactune.app.analysis.track_work import FrameTracker
from tactune.core import open_source
from tactune.core.estimation.object_mesh import simulated_mesh
from tactune.core.sources.presets import load_preset
from tactune.core.sources.simulator.scenes import resolve_scene
from tactune.core.sources.simulator.source import SimulatorSource
from truth_scene import click_at

PRESSED = 40


@pytest.fixture(scope="module")
def cup_file(tmp_path_factory):
    pytest.importorskip("open3d")
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
    drop(made, cup_file)
    qtbot.waitUntil(lambda: made.model is not None)
    analysis.activateWindow()
    qtbot.waitUntil(analysis.isActiveWindow)
    made.main = window
    return made


def true_pose(source, index=PRESSED):
    return np.array(source.read(index).truth.T_proximity_object)


def find(qtbot, tab):
    QTest.mouseClick(tab.find_button, LEFT)
    qtbot.waitUntil(lambda: tab.tracked is not None, timeout=30_000)


def test_a_mesh_is_opened_refused_or_taken_from_the_simulator(qtbot, tab, source, tmp_path):
    model = tab.model
    assert "cup.stl was read in mm: 107 x 92 x 74 mm" in tab.messages.sentences()[-1]
    assert np.ptp(model.mesh.vertices_m[:, 0]) == pytest.approx(0.107, abs=0.002)
    assert tab.views.model.point_count() > 5000
    assert "Press Find" in tab.guide.text()
    (tmp_path / "broken.stl").write_text("no mesh", encoding="ascii")
    tab.open_mesh(tmp_path / "broken.stl")
    qtbot.waitUntil(lambda: any("roken.stl" in sentence for sentence in tab.messages.sentences()))
    assert tab.model is model and not tab.progress.isVisible()
    QTest.mouseClick(tab.simulated, LEFT)
    qtbot.waitUntil(lambda: tab.model.mesh.name == "cup")
    np.testing.assert_array_equal(tab.model.mesh.vertices_m, simulated_mesh(source.scene, source.name).vertices_m)
    tab.unit.setFocus()
    QTest.keyClick(tab.unit, Qt.Key.Key_Down)
    assert not tab.progress.isVisible(), "another unit reads the file that was open before"


def test_the_cup_is_found_followed_exported_lost_and_found_again(qtbot, tab, source, tmp_path, cup_file):
    assert tab.align.isVisible() and not tab.pose.isVisible() and not tab.errors.isVisible()
    find(qtbot, tab)
    qtbot.waitUntil(tab.errors.isVisible)
    assert tab.pose.isVisible() and not tab.align.isVisible()
    assert tab.track_button.isChecked() and tab.guide.text().startswith("Tracking")
    assert tab.tracked.error.position_m < 0.002 and tab.tracked.error.angle_rad < np.radians(2.0)
    for index in (PRESSED + 1, PRESSED - 1):
        tab.main.worker.seek(index)
        qtbot.waitUntil(lambda index=index: at_rest(tab.main, index))
        qtbot.waitUntil(lambda index=index: tab.tracked.estimate.sequence == index)
        moved = tab.tracked.estimate.T_proximity_object[2, 3] - true_pose(source, index)[2, 3]
        assert abs(moved) < 0.001
    assert "mm" in tab.pose.values[0].text() and "±" in tab.pose.sigmas[2].text()
    assert np.isfinite(tab.plot.position.yData).all() and len(tab.plot.position.yData) >= 1
    QTest.mouseClick(tab.export, LEFT)
    type_path(qtbot, tmp_path / "poses.csv")
    qtbot.waitUntil(lambda: any("poses were written" in sentence for sentence in tab.messages.sentences()))
    rows = list(csv.DictReader((tmp_path / "poses.csv").read_text(encoding="utf-8").splitlines()))
    assert [int(row["sequence"]) for row in rows][-2:] == [PRESSED + 1, PRESSED - 1]
    assert float(rows[-1]["position_error_mm"]) < 2
    tab.main.worker.seek(0)
    qtbot.waitUntil(lambda: "No contact" in tab.guide.text())
    assert tab.pose.values[0].text() == "–"
    tab.main.worker.seek(PRESSED)
    qtbot.waitUntil(lambda: tab.guide.text().startswith("Tracking"))
    tab.open_mesh(cup_file)
    qtbot.waitUntil(lambda: any("Tracking cup.stl ended after" in sentence for sentence in tab.messages.sentences()))
    assert not tab.export.isEnabled(), "the poses can be saved from the message"


def test_three_clicked_pairs_give_the_start_and_undo_takes_them_back(qtbot, tab, source):
    pose = true_pose(source)
    patch = tab.main.result.patch.points
    for corner in (patch[:, 0].argmin(), patch[:, 0].argmax(), patch[:, 1].argmax()):
        place = patch[corner]
        seen = np.concatenate([points for points, _ in tab.model.groups])
        on_model = np.linalg.inv(pose) @ [*place, 1.0]
        model_point = seen[np.linalg.norm(seen - on_model[:3], axis=1).argmin()]
        click_at(tab.views.model, model_point)
        click_at(tab.views.scene, place)
        qtbot.waitUntil(lambda: tab.session.state.pending is None)
    assert np.abs(np.array(tab.session.state.pose) - pose).max() < 0.15
    assert tab.views.scene.handles() is not None
    assert tab.views.follow.isEnabled()  # the frame that was clicked on is held
    QTest.mouseClick(tab.track_button, LEFT)
    qtbot.waitUntil(lambda: tab.tracked is not None)
    assert not tab.tracked.estimate.lost
    assert tab.tracked.error.position_m < 0.003
    QTest.mouseClick(tab.track_button, LEFT)
    assert np.allclose(tab.session.state.pose, tab.tracked.estimate.T_proximity_object)
    while tab.session.undo_stack.canUndo():
        QTest.keyClick(tab, Qt.Key.Key_Z, Qt.KeyboardModifier.ControlModifier)
    assert tab.session.state.pairs == () and tab.session.state.pose is None


def test_a_wrong_mesh_is_refused_by_its_residual(qtbot, tab, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box((0.09, 0.09, 0.004)).export(tmp_path / "plate.ply")
    tab.open_mesh(tmp_path / "plate.ply")
    qtbot.waitUntil(lambda: tab.model.mesh.name == "plate.ply")
    QTest.mouseClick(tab.find_button, LEFT)
    words = "The mesh plate.ply does not fit the contact"
    qtbot.waitUntil(lambda: any(words in sentence for sentence in tab.messages.sentences()), timeout=30_000)
    assert not tab.track_button.isChecked()
    assert tab.session.state.pose is None


@pytest.mark.parametrize("how", ["cancel", "another mesh"])
def test_a_search_tells_its_progress_and_can_be_given_up(qtbot, tab, monkeypatch, cup_file, how):
    ended = Event()

    class Endless:
        def __init__(self, *_: object) -> None:
            pass

        def find(self, _result: object, progress: Callable[[float, str], None]) -> np.ndarray:
            try:
                for share in chain([0.25], repeat(0.5)):
                    progress(share, "Searching for cup.stl")
                    Event().wait(0.01)
            finally:
                ended.set()

    monkeypatch.setattr(track_tab, "FrameTracker", Endless)
    QTest.mouseClick(tab.find_button, LEFT)
    qtbot.waitUntil(lambda: tab.progress.value() == tab.progress.maximum() // 2)
    assert tab.cancel.isVisible() and tab.guide.text().startswith("Searching")
    if how == "cancel":
        QTest.mouseClick(tab.cancel, LEFT)
    else:
        tab.open_mesh(cup_file)
    qtbot.waitUntil(ended.is_set)
    qtbot.waitUntil(lambda: not tab.cancel.isVisible() and tab.guide.text().startswith("Press Find"))
    assert not tab.track_button.isChecked() and tab.session.state.pose is None


def test_a_search_of_the_whole_patch_ends_where_its_progress_raises(tab):
    shares = []

    def stop(share: float, _words: str) -> None:
        shares.append(share)
        if len(shares) == 20:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        FrameTracker(tab.model.mesh, None).find(tab.main.result, stop)
    assert shares == sorted(shares) and 0 <= shares[0] < shares[-1] < 0.5


def test_poses_are_published_and_recorded_also_behind_another_tab(qtbot, tab, tmp_path):
    tab.main.settings.set("folder/recordings", str(tmp_path))
    publishing = tab.main.publishing.window
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    QTest.keyClick(tab.main, Qt.Key.Key_P, CONTROL_SHIFT)
    type_into(publishing.port, str(port), Qt.Key.Key_Tab)
    QTest.mouseClick(publishing.start, LEFT)
    qtbot.waitUntil(lambda: str(port) in publishing.state.text())
    find(qtbot, tab)
    tab.main.analysis.window.open_on("tilt")
    tab.main.actions_.record.trigger()
    qtbot.waitUntil(lambda: tab.main.recording.running)
    topics = ["/contact/patch", "/object/pose", "/tf"]
    with FoxgloveClient(port) as client:
        client.subscribe(topics)
        qtbot.waitUntil(lambda: "1 client," in publishing.state.text())
        tab.main.worker.seek(PRESSED + 1)
        qtbot.waitUntil(lambda: tab.tracked.estimate.sequence == PRESSED + 1)
        seen = next(client.frames(topics))
    estimate, pose = tab.tracked.estimate, seen["/object/pose"].pose
    assert pose.pose.position.x == seen["/tf"].transforms[0].transform.translation.x
    assert pose.pose.position.x == estimate.T_proximity_object[0, 3]
    np.testing.assert_array_equal(pose.covariance, estimate.covariance.ravel())
    tab.main.worker.play()
    qtbot.waitUntil(lambda: tab.tracked.estimate.sequence > PRESSED + 1)
    estimate = tab.tracked.estimate
    tab.main.actions_.record.trigger()
    qtbot.waitUntil(lambda: not tab.main.recording.running and any(tmp_path.glob("*.mcap")))
    [path] = tmp_path.glob("*.mcap")
    with path.open("rb") as file:
        read = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(["/object/pose"])
        recorded = {message.sequence: decoded.pose for _, _, message, decoded in read}
    with open_source(f"mcap:{path}") as played:
        frames = [frame.sequence for frame in played]
    assert frames[0] == PRESSED
    assert set(recorded) <= set(frames)  # a frame that is only shown has no pose in the file
    kept = recorded[estimate.sequence]
    assert kept.pose.position.x == estimate.T_proximity_object[0, 3]
    np.testing.assert_array_equal(kept.covariance, estimate.covariance.ravel())
