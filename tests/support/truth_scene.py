"""A painted plate that fits the patch of the tiny recording, and hands for the tab that aligns it."""

from __future__ import annotations

import time
from pathlib import Path
from threading import Event

import numpy as np
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QWidget

from hands import LEFT
from tactune.app.analysis.truth_tab import TruthTab
from tactune.app.window.main_window import MainWindow
from tactune.app.worker.jobs import Progress
from tactune.widgets.clouds.pick_view import PickView

PINK, PURPLE = (235, 80, 160), (90, 60, 150)
SIDE, HALF_M = 61, 0.06
#: Where the disc of the tiny recording's frame 3 lies, and how large it is.
DISC_M, DISC_CENTRE = 7 * 0.252 / 60, (0.5 * 0.252 / 60, 0.5 * 0.252 / 60, 0.2522)
#: A place that lies beside it.
DISC_CENTRE_BESIDE = (-0.04, 0.03, 0.2522)


class EndlessWork:
    """Work of a job that ends only when it is cancelled."""

    def __init__(self) -> None:
        self.began = Event()

    def __call__(self, progress: Progress) -> None:
        while True:
            progress(0.2, "Working")
            self.began.set()
            time.sleep(0.002)


def true_pose() -> np.ndarray:
    """T_proximity_scan of the plate: turned by 0.4 rad about the viewing axis."""
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]]
    pose[:3, 3] = DISC_CENTRE
    return pose


def write_plate(path: Path, unit_m: float = 1.0) -> Path:
    """Write a purple plate with a pink disc as PLY."""
    axis = np.linspace(-HALF_M, HALF_M, SIDE)
    x, y = (grid.ravel() for grid in np.meshgrid(axis, axis))
    pink = np.hypot(x, y) < DISC_M
    lines = [
        f"{px / unit_m:.6f} {py / unit_m:.6f} 0 {' '.join(map(str, PINK if touched else PURPLE))}"
        for px, py, touched in zip(x, y, pink, strict=True)
    ]
    corner = (np.arange(SIDE - 1)[:, None] * SIDE + np.arange(SIDE - 1)).ravel()
    faces = [f"3 {c} {c + 1} {c + SIDE}\n3 {c + 1} {c + SIDE + 1} {c + SIDE}" for c in corner]
    head = [
        "ply",
        "format ascii 1.0",
        f"element vertex {len(lines)}",
        *(f"property float {name}" for name in "xyz"),
        *(f"property uchar {name}" for name in ("red", "green", "blue")),
        f"element face {2 * len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    path.write_text("\n".join([*head, *lines, *faces]) + "\n", encoding="ascii")
    return path


def open_tab(qtbot, window: MainWindow) -> TruthTab:
    """Open the tab by its key."""
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow)
    QTest.keyClick(window, Qt.Key.Key_F8)
    analysis = window.analysis.window
    assert analysis is not None
    qtbot.waitExposed(analysis)
    analysis.activateWindow()
    qtbot.waitUntil(analysis.isActiveWindow)
    tab = analysis.made["truth"]
    assert isinstance(tab, TruthTab)
    return tab


def open_plate(qtbot, tab: TruthTab, path: Path) -> None:
    """Open the scan and wait for its contact."""
    tab.open_scan(path)
    settle(qtbot, tab)


def settle(qtbot, tab: TruthTab) -> None:
    """Wait until the contact is that of the paint's settings."""

    def done() -> bool:
        contact = tab.flow.contact
        return contact is not None and contact.paint == tab.flow.state.paint

    qtbot.waitUntil(done)


def pixel_of(view: PickView, place: object) -> QPoint:
    """Where in the view's window a place is drawn."""
    canvas, top = view.findChild(QWidget, "canvas"), view.window()
    assert canvas is not None and top is not None
    u, v, _ = view.camera().project(np.array([place]), canvas.width(), canvas.height())[0]
    return canvas.mapTo(top, QPoint(int(u), int(v)))


def click_at(view: PickView, place: object) -> None:
    """Click where a place is drawn."""
    top = view.window()
    assert top is not None
    QTest.mouseClick(top.windowHandle(), LEFT, Qt.KeyboardModifier.NoModifier, pixel_of(view, place))


def drag(view: PickView, start: QPoint, end: QPoint, modifier: Qt.KeyboardModifier) -> None:
    """Drag from one pixel of the window to another."""
    top = view.window()
    assert top is not None
    handle = top.windowHandle()
    QTest.mousePress(handle, LEFT, modifier, start)
    for step in range(1, 5):
        QTest.mouseMove(handle, start + (end - start) * step / 4)
    QTest.mouseRelease(handle, LEFT, modifier, end)


def click_pair(tab: TruthTab, patch_point: object) -> None:
    """Click the scan's vertex that lies nearest to a point of the patch, then that point."""
    in_scan = np.linalg.inv(true_pose()) @ [*np.asarray(patch_point, float), 1.0]
    vertices = tab.flow.loaded.scan.vertices_m
    click_at(tab.views.scan, vertices[np.linalg.norm(vertices - in_scan[:3], axis=1).argmin()])
    click_at(tab.views.patch, patch_point)


def corners(tab: TruthTab) -> list[np.ndarray]:
    """Three points of the patch that lie far from each other."""
    points = tab.flow.patch.points
    return [points[points[:, 0].argmin()], points[points[:, 0].argmax()], points[points[:, 1].argmin()]]


def click_three_pairs(tab: TruthTab) -> None:
    """Align by three pairs."""
    for point in corners(tab):
        click_pair(tab, point)


def pose_of(tab: TruthTab) -> np.ndarray:
    """T_proximity_scan as the tab has it."""
    return np.array(tab.flow.state.pose)


def corner_errors_mm(tab: TruthTab) -> np.ndarray:
    """How far the corners of the plate lie from their true places."""
    plate = np.array([(x, y, 0.0, 1.0) for x in (-HALF_M, HALF_M) for y in (-HALF_M, HALF_M)])
    return 1e3 * np.linalg.norm((plate @ (pose_of(tab) - true_pose()).T)[:, :3], axis=1)
