"""Print how long the three cloud views take to repaint, for each back end.

Usage: ``python scripts/bench_views.py [--frames N] [--width W] [--height H]``. A display is needed for
OpenGL (``xvfb-run -a`` is enough); with ``QT_QPA_PLATFORM=offscreen`` only the software painter is measured.
Every repaint gets a new depth image, new colours and a new camera, so nothing comes from a cache.
"""

from __future__ import annotations

import argparse
import sys
import time
from ctypes import CFUNCTYPE
from dataclasses import replace

import numpy as np
from PyQt6.QtCore import Qt
from PyQt6.QtOpenGLWidgets import QOpenGLWidget
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication, QHBoxLayout, QWidget

from tactune.core.model.intrinsics import Intrinsics
from tactune.core.model.provenance import Provenance
from tactune.widgets.basics.colormaps import depth_lut, difference_index, difference_lut, provenance_lut
from tactune.widgets.clouds.cloud_data import DepthCloud
from tactune.widgets.clouds.cloud_view import BackendChoice, CloudView, link_cameras
from tactune.widgets.clouds.gl_backend import probe_opengl

LENS = Intrinsics(width=640, height=480, fx=460.0, fy=460.0, cx=320.0, cy=240.0)
RAYS = LENS.rays()
UNIT_M = 0.00025
POSE = np.eye(4)


def frames(count: int) -> list[list[DepthCloud]]:
    """Return the three clouds for each frame of a noisy bowl, with all 307,200 points."""
    rng = np.random.default_rng(0)
    bowl = 0.314 - 0.2 * (RAYS**2).sum(axis=2)
    made = []
    for _ in range(count):
        depth = ((bowl + rng.normal(0, 0.0005, bowl.shape)) / UNIT_M).astype(np.uint16)
        difference = rng.normal(0, 0.03, bowl.shape).astype(np.float32)
        provenance = np.full(bowl.shape, Provenance.OUTSIDE_TOLERANCE, np.uint8)
        provenance[np.abs(difference) < 0.01] = Provenance.CONTACT
        coloured = (
            (depth_lut(), None),
            (difference_lut(), difference_index(difference)),
            (provenance_lut("dark"), provenance),
        )
        made.append(
            [
                DepthCloud(depth, UNIT_M, RAYS, lut, POSE, index=index, depth_range_m=(0.2, 0.32))
                for lut, index in coloured
            ]
        )
    return made


def canvas_of(view: CloudView) -> QWidget:
    """Return the part of a view that shows the cloud."""
    canvas = view.findChild(QWidget, "canvas")
    assert canvas is not None
    return canvas


def wait_for_graphics(canvas: QWidget) -> None:
    """Wait until OpenGL has finished drawing."""
    if isinstance(canvas, QOpenGLWidget):
        canvas.makeCurrent()
        context = canvas.context()
        if context is not None:
            CFUNCTYPE(None)(int(context.getProcAddress(b"glFinish") or 0))()
        canvas.doneCurrent()


def measure(backend: BackendChoice, clouds: list[list[DepthCloud]], width: int, height: int) -> None:
    """Show three views, each ``width`` x ``height`` pixels of cloud, and time their repaints."""
    window = QWidget()
    layout = QHBoxLayout(window)
    views = [CloudView(title, backend) for title in ("Proximity", "Tactile", "Contact patch")]
    for view in views:
        layout.addWidget(view)
    link_cameras(views)
    window.show()
    QTest.qWaitForWindowExposed(window)
    border = views[0].size() - canvas_of(views[0]).size()
    for view in views:
        view.setFixedSize(width + border.width(), height + border.height())
    QApplication.processEvents()
    for view, cloud in zip(views, clouds[0], strict=True):
        view.set_cloud(cloud)
    QApplication.processEvents()
    if views[0].backend_name != backend:
        sys.stdout.write(f"{backend:9} not measured: {views[0].backend_reason}\n")
        return
    wall, busy = [], []
    for frame in clouds:
        started, busy_before = time.perf_counter(), time.thread_time()
        views[0].set_camera(replace(views[0].camera(), azimuth=views[0].camera().azimuth + 0.02))
        for view, cloud in zip(views, frame, strict=True):
            view.set_cloud(cloud)
        QApplication.processEvents()
        for view in views:
            wait_for_graphics(canvas_of(view))
        wall.append((time.perf_counter() - started) * 1000)
        busy.append((time.thread_time() - busy_before) * 1000)
    size = canvas_of(views[0]).size()
    sys.stdout.write(
        f"{backend:9} {size.width()} x {size.height()}  three views: median {np.median(wall):.1f} ms, "
        f"p95 {np.percentile(wall, 95):.1f} ms;  one view: {np.median(wall) / 3:.1f} ms, "
        f"of which the GUI thread is busy {np.median(busy) / 3:.1f} ms\n"
    )
    window.close()


def main() -> None:
    """Measure both back ends."""
    parser = argparse.ArgumentParser(description="Time the repaints of three cloud views.")
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--width", type=int, default=640)
    parser.add_argument("--height", type=int, default=480)
    options = parser.parse_args()
    QApplication.setAttribute(Qt.ApplicationAttribute.AA_ShareOpenGLContexts)
    application = QApplication(sys.argv[:1])
    probe = probe_opengl()
    sys.stdout.write(f"OpenGL renderer: {probe.renderer or 'none'}\n")
    clouds = frames(options.frames)
    backends: tuple[BackendChoice, ...] = ("software", "opengl")
    for backend in backends:
        measure(backend, clouds, options.width, options.height)
    application.closeAllWindows()


if __name__ == "__main__":
    main()
