"""A dotted, curved membrane before two small cameras whose pose is known."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import numpy.typing as npt
import pytest
from PyQt6.QtCore import QEvent, Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication, QWidget
from scipy.spatial.transform import Rotation

from tactune.app.calibration.wizard import CalibrationWizard
from tactune.app.context import Context
from tactune.app.document.document import Document
from tactune.app.settings import Settings
from tactune.app.worker.playback import PlaybackState
from tactune.app.worker.results import SourceInfo
from tactune.app.worker.worker import Worker
from tactune.core.model.frames import ColorCamera, DepthCamera, Rig, SensorFrame, rigid_transform
from tactune.core.model.intrinsics import Intrinsics
from tactune.core.preset import Preset
from tactune.widgets.basics.dialogs import Dialogs
from tactune.widgets.basics.messages import Messages

WIDTH, HEIGHT = 320, 240
FLAT_M, TALLEST_M = 0.33, 0.06
NOBODY = Qt.KeyboardModifier.NoModifier


def pose(degrees, translation_m):
    """A rigid transform from small turns about x, y, z."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()
    matrix[:3, 3] = translation_m
    return rigid_transform(matrix)


@dataclass(frozen=True, eq=False)
class Scene:
    """The rig as it says, the pose as it is, and where the dots are."""

    rig: Rig
    T_p_t: npt.NDArray[np.float64]
    dots: npt.NDArray[np.float64]

    def height_m(self, points, level):
        """Distance of the membrane along z in the proximity frame; a cushion that bulges towards the cameras."""
        x, y = (points[..., 0] - 0.02) / 0.14, points[..., 1] / 0.10
        return np.asarray(FLAT_M - level * TALLEST_M * np.exp(-(x**2 + y**2)))

    def points(self, level):
        """The dots in the proximity depth frame, (N, 3)."""
        return np.column_stack([self.dots, self.height_m(self.dots, level)])

    def proximity_pixels(self, level):
        T = np.asarray(self.rig.proximity_color.T_color_depth)
        return self.rig.proximity_color.intrinsics.project(self.points(level) @ T[:3, :3].T + T[:3, 3])

    def tactile_pixels(self, level):
        T = np.linalg.inv(self.T_p_t)
        return self.rig.tactile.intrinsics.project(self.points(level) @ T[:3, :3].T + T[:3, 3])

    def frame(self, number, level):
        """What both cameras see at one inflation level."""
        tactile_m = self._tactile_depth(level)
        counts = np.rint(tactile_m / self.rig.tactile.depth_unit_m)
        proximity = np.full((HEIGHT, WIDTH), (FLAT_M + 0.03) / self.rig.proximity.depth_unit_m)
        return SensorFrame(
            sequence=number,
            proximity_depth=np.rint(proximity).astype(np.uint16),
            tactile_depth=counts.astype(np.uint16),
            proximity_color=_dotted(self.proximity_pixels(level)),
            tactile_color=_dotted(self.tactile_pixels(level)),
        )

    def alignment_error_px(self, T_p_t):
        """Root mean square error of a pose over the membrane at all levels, proximity depth pixels."""
        squares = []
        for level in (0.2, 0.6, 1.0):
            seen = self.points(level)
            tactile = (seen - self.T_p_t[:3, 3]) @ self.T_p_t[:3, :3]
            found = tactile @ T_p_t[:3, :3].T + T_p_t[:3, 3]
            lens = self.rig.proximity.intrinsics
            squares.append(((lens.project(found) - lens.project(seen)) ** 2).sum(axis=1))
        return float(np.sqrt(np.mean(squares)))

    def _tactile_depth(self, level):
        rays = np.concatenate(
            [self.rig.tactile.intrinsics.rays().astype(np.float64), np.ones((HEIGHT, WIDTH, 1))], axis=2
        )
        turned, shift = rays @ self.T_p_t[:3, :3].T, self.T_p_t[:3, 3]
        depth = np.full((HEIGHT, WIDTH), FLAT_M)
        for _ in range(30):
            points = turned * depth[..., None] + shift
            depth += (self.height_m(points, level) - points[..., 2]) / turned[..., 2]
        return depth


def _dotted(centers):
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    dark = np.zeros((HEIGHT, WIDTH))
    for x, y in centers:
        dark += np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2 * 1.6**2))
    gray = np.clip(220 - 190 * dark, 0, 255).astype(np.uint8)
    return np.repeat(gray[:, :, None], 3, axis=2)


@pytest.fixture(scope="session")
def scene():
    def lens(f, cx, cy):
        return Intrinsics(width=WIDTH, height=HEIGHT, fx=f, fy=f, cx=cx, cy=cy)

    truth = pose((0.4, -1.0, 0.3), (0.040, 0.001, -0.001))
    rig = Rig(
        proximity=DepthCamera(model="L515", serial="p1", intrinsics=lens(230.0, 161.0, 119.0), depth_unit_m=0.00025),
        tactile=DepthCamera(model="D405", serial="t1", intrinsics=lens(200.0, 158.0, 121.0), depth_unit_m=0.0001),
        proximity_color=ColorCamera(
            intrinsics=lens(226.0, 159.0, 121.0), T_color_depth=pose((0.2, -0.1, 0.1), (0.0, 0.014, -0.001))
        ),
        T_proximity_tactile=pose((0.0, 0.0, 0.0), (0.036, 0.0, 0.0)),
    )
    x, y = np.meshgrid(np.linspace(-0.13, 0.15, 9), np.linspace(-0.10, 0.10, 7))
    rng = np.random.default_rng(3)
    dots = np.column_stack([x.ravel(), y.ravel()]) + rng.uniform(-0.004, 0.004, (63, 2))
    return Scene(rig, np.asarray(truth), dots)


@pytest.fixture(scope="session")
def frames(scene):
    return {level: scene.frame(number, level) for number, level in enumerate((0.2, 1.0))}


class Feed:
    """What the main window would show, put on its screen by hand."""

    def __init__(self, context, rig):
        self.context, self.info = context, SourceInfo("tiny", rig, 2, 30.0)

    def deliver(self, frame, playback):
        self.context.playback = playback
        self.context.result = SimpleNamespace(
            source=self.info, frame=frame, playback=playback, frame_number=playback.index
        )
        self.context.frameShown.emit()
        self.context.worker.recorder.put(frame)


@pytest.fixture
def document():
    return Document(Preset(name="tiny", contact_test="tolerance"))


@pytest.fixture
def feed(qtbot, scene, frames, document, tmp_path):
    window, settings = QWidget(), Settings(tmp_path / "window.json")
    qtbot.addWidget(window)
    worker = Worker(Preset())  # never started, so that it answers no order
    dialogs = Dialogs(None, settings, native=False)
    made = Feed(Context(document, worker, Messages(window), dialogs, settings, tmp_path, window), scene.rig)
    made.deliver(frames[0.2], PlaybackState(index=0, length=2))
    return made


@pytest.fixture
def open_wizard(qtbot, feed):
    opened = []

    def open_it():
        wizard = CalibrationWizard(feed.context, feed.info.rig)
        opened.append(wizard)
        wizard.resize(1240, 760)
        wizard.show()
        wizard.activateWindow()
        qtbot.waitUntil(wizard.isActiveWindow)
        return wizard

    yield open_it
    for wizard in opened:
        wizard.close()
        wizard.deleteLater()
    QApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)
    QApplication.processEvents()


class Hand:
    """Real mouse events at image places."""

    def at(self, image, place):
        """The screen position of an image place."""
        return image.screen_place(float(place[0]), float(place[1])).toPoint()

    def click(self, image, place, modifiers=NOBODY):
        viewport, position = image.view.viewport(), self.at(image, place)
        QTest.mouseMove(viewport, position)
        QTest.mouseClick(viewport, Qt.MouseButton.LeftButton, modifiers, position)

    def drag(self, image, start, end):
        viewport = image.view.viewport()
        first, last = self.at(image, start), self.at(image, end)
        QTest.mousePress(viewport, Qt.MouseButton.LeftButton, NOBODY, first)
        for share in (0.3, 0.7, 1.0):
            QTest.mouseMove(viewport, first + (last - first) * share)
        QTest.mouseRelease(viewport, Qt.MouseButton.LeftButton, NOBODY, last)


@pytest.fixture
def hand():
    return Hand()
