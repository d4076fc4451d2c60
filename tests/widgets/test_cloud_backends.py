"""Which back end a cloud view uses, and its fallback when OpenGL fails."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QHBoxLayout, QWidget
from pytestqt.qtbot import QtBot

from seen_clouds import FRONT, GREEN, RED, canvas_of, cloud_of, colored, drag, picture, pixels_of, red_wall, shown
from tactune.core.model.intrinsics import Intrinsics
from tactune.widgets.basics.wipe import Wipe
from tactune.widgets.clouds import gl_backend
from tactune.widgets.clouds.cloud_data import DepthCloud
from tactune.widgets.clouds.cloud_view import BackendChoice, CloudView
from tactune.widgets.clouds.gl_backend import GLCanvas, GLError, GLProbe, GLRenderer
from tactune.widgets.clouds.software_backend import SoftwareRenderer


@pytest.mark.parametrize("choice", ["auto", "opengl"])
def test_without_opengl_the_software_draws_and_says_why(
    qtbot: QtBot, monkeypatch: pytest.MonkeyPatch, choice: BackendChoice
) -> None:
    monkeypatch.setattr(gl_backend, "probe_opengl", lambda: GLProbe(False, False, "", "no OpenGL on this display"))
    view = shown(qtbot, CloudView("V", choice))
    assert view.backend_name == "software"
    assert view.backend_reason == "Software view: no OpenGL on this display"
    assert view.backend_reason in view.toolTip()
    view.set_camera(FRONT)
    corner = picture(view)[-24:, 150:]
    unexplained = shown(qtbot, CloudView("V", "software"))
    unexplained.set_camera(FRONT)
    assert (corner != picture(unexplained)[-24:, 150:]).any(), "the reason is written on the view"


def test_asking_for_software_needs_no_reason(qtbot: QtBot) -> None:
    view = shown(qtbot, CloudView("V", "software"))
    assert (view.backend_name, view.backend_reason) == ("software", "")


def test_emulated_opengl_is_used_only_when_insisted_on(qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> None:
    probe = GLProbe(True, True, "llvmpipe (LLVM 15)", "OpenGL is only emulated here (llvmpipe)")
    monkeypatch.setattr(gl_backend, "probe_opengl", lambda: probe)
    view = CloudView("V", "auto")
    qtbot.addWidget(view)
    assert view.backend_name == "software"
    assert "only emulated here (llvmpipe)" in view.backend_reason
    insisted = CloudView("V", "opengl")
    qtbot.addWidget(insisted)
    assert (insisted.backend_name, insisted.backend_reason) == ("opengl", "")


def test_real_opengl_is_taken_by_itself(qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gl_backend, "probe_opengl", lambda: GLProbe(True, False, "A real one", ""))
    view = CloudView("V", "auto")
    qtbot.addWidget(view)
    assert (view.backend_name, view.backend_reason) == ("opengl", "")


def assert_it_falls_back(qtbot: QtBot, view: CloudView, words: str) -> None:
    camera = view.camera()
    qtbot.waitUntil(lambda: view.backend_name == "software")
    assert words in view.backend_reason
    assert view.camera() == camera
    assert len(pixels_of(picture(view), RED)) > 1000
    drag(view, (100, 100), (140, 120), Qt.MouseButton.LeftButton)
    assert view.camera() != camera, "it can still be steered"
    qtbot.waitUntil(lambda: view.findChildren(GLCanvas) == [])


def test_it_goes_on_in_software_where_the_window_gets_no_context(qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> None:
    if gl_backend.probe_opengl().usable:
        pytest.skip("this display has OpenGL, so a context can be made")
    monkeypatch.setattr(gl_backend, "probe_opengl", lambda: GLProbe(True, False, "A real one", ""))
    view = CloudView("V", "auto")
    view.set_cloud(red_wall())
    view.set_camera(FRONT)
    assert_it_falls_back(qtbot, shown(qtbot, view), "no OpenGL context could be made")


@pytest.mark.gl
@pytest.mark.parametrize("moment", ["__init__", "render"])
def test_it_goes_on_in_software_when_opengl_fails(
    qtbot: QtBot, opengl: BackendChoice, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    view = CloudView("V", opengl)
    view.set_cloud(red_wall())
    view.set_camera(FRONT)
    if moment == "render":
        shown(qtbot, view)
        assert len(pixels_of(picture(view), RED)) > 1000

    def fail(*_: object) -> None:
        raise GLError("the graphics driver was reset")

    monkeypatch.setattr(GLRenderer, moment, fail)
    if moment == "__init__":
        shown(qtbot, view)
    else:
        canvas_of(view).update()
    assert view.isVisible()
    assert_it_falls_back(qtbot, view, "the graphics driver was reset")


def test_it_survives_moving_to_another_window(
    view: CloudView, backend: BackendChoice, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    freed: list[GLRenderer] = []
    destroy = GLRenderer.destroy
    monkeypatch.setattr(GLRenderer, "destroy", lambda renderer: (freed.append(renderer), destroy(renderer)))
    view.set_cloud(red_wall())
    view.set_camera(FRONT)
    before = len(pixels_of(picture(view), RED))
    other = QWidget()
    layout = QHBoxLayout(other)
    layout.addWidget(view)
    qtbot.addWidget(other)
    other.resize(500, 420)
    with qtbot.waitExposed(other):
        other.show()
    assert view.backend_name == backend
    assert len(pixels_of(picture(view), RED)) > before / 2
    assert len(freed) == (backend == "opengl"), "graphics memory of the former window is freed"
    view.setParent(None)


def dense_cloud(every: int = 1, holes: bool = True) -> DepthCloud:
    """A stepped red and green wall of 640 x 480 pixels, denser than the screen, or every n-th row and column of it."""
    lens = Intrinsics(width=640, height=480, fx=460.0, fy=460.0, cx=319.5, cy=239.5)
    v, u = np.mgrid[:480, :640]
    depth = np.uint16(300) + 20 * ((u // 2 // 40) % 2).astype(np.uint16)
    if holes:
        depth[::20, ::20] = 0  # a pixel of those that are drawn when the cloud is thinned
    part = np.s_[::every, ::every]
    return cloud_of(
        depth[part],
        rays=lens.rays()[part],
        index=((u // 32 + v // 32) % 2).astype(np.uint8)[part],
        lut=colored(RED, GREEN),
        depth_range_m=(0.25, 0.35),
    )


def test_running_frames_leave_out_points_that_the_screen_cannot_tell_apart(qtbot: QtBot) -> None:
    view = shown(qtbot, CloudView("V", "software"))
    view.set_camera(FRONT)
    view.set_cloud(dense_cloud())
    whole = picture(view)
    view.set_running(True)
    running = picture(view)
    assert 0 < (running != whole).any(axis=2).mean() < 0.04, "only edges of squares move"
    view.set_running(False)
    assert (picture(view) == whole).all(), "a frame that stands still has all its points"
    view.set_cloud(dense_cloud(every=2, holes=False))
    assert (running == picture(view)).all(), "every other row and column, and no holes from single pixels without depth"


def test_running_frames_keep_points_that_the_screen_can_tell_apart(qtbot: QtBot) -> None:
    view = shown(qtbot, CloudView("V", "software"))
    view.set_camera(replace(FRONT, distance=0.2))
    view.set_cloud(dense_cloud())
    whole = picture(view)
    view.set_running(True)
    assert (picture(view) == whole).all()


def test_a_cloud_that_did_not_change_is_not_drawn_again(qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[DepthCloud | None] = []
    render = SoftwareRenderer.render
    monkeypatch.setattr(
        SoftwareRenderer, "render", lambda self, cloud, *rest: (drawn.append(cloud), render(self, cloud, *rest))[1]
    )
    view = shown(qtbot, CloudView("V", "software"))
    cloud = red_wall()
    view.set_cloud(cloud)
    view.set_camera(FRONT)
    picture(view)
    drawn.clear()
    view.set_cloud(cloud)
    view.set_badge("old")
    picture(view)
    assert drawn == []
    view.set_wipe(Wipe(0.5, "A", "B"))
    view.set_right(cloud)
    picture(view)
    assert drawn == [], "a cloud that both sides of a wipe share is drawn once"
    view.set_right(red_wall())
    picture(view)
    assert len(drawn) == 1
