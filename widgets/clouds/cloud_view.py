"""A 3D view of one organised point cloud, with an orbiting camera."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import pi, radians

import numpy as np
from PyQt6.QtCore import QEvent, QPointF, QSize, Qt, pyqtSignal
from PyQt6.QtGui import QKeyEvent, QMouseEvent, QWheelEvent
from PyQt6.QtWidgets import QWidget

from ...core.errors import counted
from ...core.model.arrays import Float64Array
from ..basics.controls import timer
from ..basics.layouts import vbox
from ..basics.overlays import Notice, Reading, Wipe
from ..basics.view_header import ViewHeader
from .cloud_canvas import CloudCanvas
from .cloud_data import DepthCloud
from .view_camera import Place, ViewCamera, Viewpoint, as_place

#: Distance in pixels within which a point is picked.
PICK_PX = 10.0
#: Distance in pixels within which a point counts as under the cursor; points are drawn as squares.
_UNDER_PX = 1.5
_ORBIT_STEP = radians(5.0)
_ZOOM_STEP = 1.15
_RING = 2
#: Milliseconds between searches for the point under the moving mouse.
_HOVER_MS = 30
#: Step in rows and columns at which a cloud is sampled for framing.
_FRAMING_STEP = 8

_KEYS: dict[int, Callable[[CloudView], None]] = {
    Qt.Key.Key_Left: lambda view: view._orbit(-_ORBIT_STEP, 0.0),
    Qt.Key.Key_Right: lambda view: view._orbit(_ORBIT_STEP, 0.0),
    Qt.Key.Key_Up: lambda view: view._orbit(0.0, _ORBIT_STEP),
    Qt.Key.Key_Down: lambda view: view._orbit(0.0, -_ORBIT_STEP),
    Qt.Key.Key_Plus: lambda view: view._zoom(_ZOOM_STEP),
    Qt.Key.Key_Equal: lambda view: view._zoom(_ZOOM_STEP),
    Qt.Key.Key_Minus: lambda view: view._zoom(1 / _ZOOM_STEP),
    Qt.Key.Key_R: lambda view: view.look_from("reset"),
    Qt.Key.Key_V: lambda view: view.look_from("front"),
    Qt.Key.Key_T: lambda view: view.look_from("top"),
    Qt.Key.Key_S: lambda view: view.look_from("side"),
}


class CloudView(QWidget):
    """Title, legend and the cloud itself; the tooltip has all colours and the number of points.

    Until somebody steers it, the camera frames the cloud by itself, and again whenever the view is resized. One that
    ``inspects`` also reports the point under the mouse, and a double click asks for the large place.
    """

    #: The wipe was dragged; carries the share of the width left of it.
    wipeDragged = pyqtSignal(float)
    pointHovered = pyqtSignal(object)  # Flat pixel and place of the point under the mouse, or None
    enlargeRequested = pyqtSignal()

    def __init__(self, title: str, *, inspects: bool = False) -> None:
        super().__init__()
        self._inspects = inspects
        self._message, self._right_message = "", ""
        self._steered = False
        self._companions: list[CloudView] = []
        #: Returns the points (N, 3), metres, that are framed instead of the clouds when the view is reset.
        self.find_focus: Callable[[], Float64Array] | None = None
        self._focus: Float64Array | None = None
        self._drag_from: QPointF | None = None
        self._drag_pans = False
        self._mouse = QPointF()
        self._hover = timer(self, _HOVER_MS, self._point, once=True)

        self.header = ViewHeader(title)
        self.canvas = CloudCanvas(self)
        self.canvas.setObjectName("canvas")
        self.canvas.resized.connect(self._frame_after_resize)
        self.canvas.grip.dragged.connect(self.wipeDragged)
        self.notice, self.badge = Notice(self.canvas), Notice(self.canvas, warns=True)
        vbox(self.header, (self.canvas, 1), within=self, margins=(_RING, 0, _RING, 0), spacing=_RING + 1)
        for widget in (self, self.canvas):
            widget.setMouseTracking(True)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setAccessibleName(f"3D view: {title}")
        #: Help on mouse and keys, for the tooltip.
        self.help = (
            "<p><b>Drag</b> to orbit, <b>Shift + drag</b> or middle button to pan, <b>wheel</b> to zoom, "
            f"<b>double click</b> to {'swap with the patch' if inspects else 'reset'}.</p>"
            "<p>Keys: <b>arrows</b> orbit, <b>+ −</b> zoom, <b>R</b> reset, <b>V</b> front, <b>T</b> top, "
            f"<b>S</b> side{', <b>Z</b> zoom to the patch' if inspects else ''}.</p>"
        )

    # What is shown

    def set_large(self, large: bool) -> None:
        """Show legend and axes, or leave them to the large view beside this one."""
        self.header.show_legend(large)
        self.canvas.shows_axes = large
        self.canvas.update()

    def set_cloud(self, cloud: DepthCloud | None) -> None:
        arrives = cloud is not None and self.canvas.cloud is None
        self.canvas.cloud = cloud
        self._show_notice()
        if cloud is not None and not self._steered and (arrives or (not self._inspects and self._overflows(cloud))):
            self.fit()
        self.canvas.update()

    def _overflows(self, cloud: DepthCloud) -> bool:
        """Tell whether what `fit` frames of a cloud is beyond the view, as a patch that grows while it is pressed."""
        size = self._size()
        seen = self.camera().project(cloud.points(_FRAMING_STEP), *size)[:, :2]
        return bool(((seen < 0) | (seen > size)).any())

    def cloud(self) -> DepthCloud | None:
        """Return the cloud that is shown, left of the wipe if there is one."""
        return self.canvas.cloud

    def set_right(self, cloud: DepthCloud | None, message: str = "") -> None:
        """Show another cloud right of the wipe; ``message`` says why it has no points."""
        self.canvas.right, self._right_message = cloud, message
        self._show_notice()
        self.canvas.update()

    def set_wipe(self, wipe: Wipe | None) -> None:
        """Divide the view between two clouds seen by the same camera, or show only one."""
        if wipe == self.canvas.grip.wipe:
            return
        self.canvas.grip.wipe = wipe
        if wipe is None:
            self.canvas.right, self._right_message = None, ""
        self._show_notice()
        self.canvas.update()

    def point_count(self) -> int:
        """Return the number of points that the view states: of the left cloud unless only the right one is seen."""
        wipe = self.canvas.grip.wipe
        cloud = self.canvas.right if wipe is not None and wipe.share <= 0 else self.canvas.cloud
        return cloud.point_count if cloud else 0

    def set_point_size(self, size: float) -> None:
        """Draw points as squares of this edge length, in device-independent pixels, at least 1."""
        self.canvas.point_size = max(1.0, float(size))
        self.canvas.update()

    def set_running(self, running: bool) -> None:
        """Say whether frames follow each other: a cloud that stands still is drawn with all its points."""
        self.canvas.running = running
        self.canvas.update()

    def set_message(self, message: str) -> None:
        """Set what `notice` says while there are no points."""
        if message != self._message:
            self._message = message
            self._show_notice()

    def set_mark(self, mark: Place | None) -> None:
        """Mark a place of the view's frame, metres, or none."""
        if mark != self.canvas.mark:
            self.canvas.mark = mark
            self.canvas.update()

    def set_arrow(self, arrow: Float64Array | None) -> None:
        """Draw an arrow between two places (2, 3) of the view's frame, metres, or none."""
        if arrow is not self.canvas.arrow:
            self.canvas.arrow = arrow
            self.canvas.update()

    def set_readings(self, readings: tuple[Reading, ...]) -> None:
        """Show numbers in large type over the upper left corner."""
        if readings != self.canvas.readings:
            self.canvas.readings = readings
            self.canvas.update()

    def _show_notice(self) -> None:
        wipe = self.canvas.grip.wipe
        share = 1.0 if wipe is None else wipe.share
        sides = [(self.canvas.cloud, self._message)] if share > 0 else []
        if share < 1:
            sides.append((self.canvas.right, self._right_message))
        empty = not any(cloud is not None and cloud.point_count for cloud, _ in sides)
        self.notice.set_text(sides[0][1] if empty else "")

    # Camera

    def camera(self) -> ViewCamera:
        return self.canvas.camera

    def set_camera(self, camera: ViewCamera) -> None:
        """Move the camera and those of linked views; automatic framing ends."""
        self._move(camera, steered=True)

    def refocus(self) -> None:
        """Find the points to frame again, and frame them in all linked views, keeping the direction."""
        self._look_for_focus()
        self._frame(self.camera(), steered=False)

    def _look_for_focus(self) -> None:
        if self.find_focus is not None:
            focus = self.find_focus()
            for view in (self, *self._companions):
                view._focus = focus

    def zoom_to(self, points: Float64Array, fill: float) -> None:
        """Let points (N, 3), metres, take a share of this view, keeping the direction; automatic framing ends."""
        self.set_camera(self.camera().framing(points, *self._size(), fill))

    def look_from(self, viewpoint: Viewpoint) -> None:
        if viewpoint == "reset":
            self._look_for_focus()
        self._frame(self.camera().looking_from(viewpoint), steered=viewpoint != "reset")

    def fit(self) -> None:
        """Frame the clouds of this and all linked views, keeping the direction of view."""
        self._frame(self.camera(), self._steered)

    def _frame(self, camera: ViewCamera, steered: bool) -> None:
        views = [view for view in (self, *self._companions) if view is self or not view.isHidden()]
        clouds = [cloud for view in views if (cloud := view.cloud()) is not None]
        sizes = np.array([view._size() for view in views])
        width, height = (sizes / sizes.min(axis=1, keepdims=True)).min(axis=0)  # so that each view shows everything
        if self._focus is not None and len(self._focus):
            camera = camera.framing(self._focus, width, height)
        elif clouds:
            points = np.concatenate([cloud.points(_FRAMING_STEP) for cloud in clouds])
            camera = camera.framing(points, width, height)
        self._move(camera, steered)

    def _size(self) -> tuple[int, int]:
        return max(1, self.canvas.width()), max(1, self.canvas.height())

    def _move(self, camera: ViewCamera, steered: bool) -> None:
        for view in (self, *self._companions):
            view._place(camera, steered)

    def _place(self, camera: ViewCamera, steered: bool) -> None:
        self._steered = steered
        if camera != self.canvas.camera:
            self.canvas.camera = camera
            self.canvas.update()

    def pick(self, at: QPointF) -> tuple[int, Place] | None:
        """Return flat pixel and place of the point nearest to the eye at a position of the canvas, or beside it."""
        width, height = self._size()
        wipe = self.canvas.grip.wipe
        right = wipe is not None and at.x() >= wipe.column(width)
        cloud = self.canvas.right if right else self.canvas.cloud
        if cloud is None:
            return None
        found = cloud.near(self.camera().pixel_matrix(width, height), (at.x(), at.y()), PICK_PX)
        if not len(found):
            return None
        points = cloud.places(found)
        seen = self.camera().project(points, width, height)
        off = np.abs(seen[:, :2] - (at.x(), at.y())).max(axis=1)
        under = np.flatnonzero(off <= max(float(off.min()), _UNDER_PX))
        chosen = under[np.argmin(seen[under, 2])]
        return int(found[chosen]), as_place(points[chosen])

    # Events

    def sizeHint(self) -> QSize:
        return QSize(420, 440)

    def minimumSizeHint(self) -> QSize:
        return QSize(120, 100)

    def _frame_after_resize(self) -> None:
        if not self._steered and self.canvas.cloud is not None:
            self.fit()

    def event(self, event: QEvent | None) -> bool:
        """Claim the keys of this view before shortcuts of the application; write the tooltip when it is asked for."""
        if isinstance(event, QKeyEvent) and event.type() == QEvent.Type.ShortcutOverride and self._knows(event):
            event.accept()
            return True
        if event is not None and event.type() == QEvent.Type.ToolTip:
            self.setToolTip(f"{self.header.legend_tip()}<p>{counted(self.point_count(), 'point')}</p>{self.help}")
        return super().event(event)

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        if event is None or not self._knows(event):
            super().keyPressEvent(event)
            return
        _KEYS[event.key()](self)

    @staticmethod
    def _knows(event: QKeyEvent) -> bool:
        plain = Qt.KeyboardModifier.ShiftModifier | Qt.KeyboardModifier.KeypadModifier
        return event.key() in _KEYS and not event.modifiers() & ~plain

    def mousePressEvent(self, event: QMouseEvent | None) -> None:
        if event is None or event.button() not in (Qt.MouseButton.LeftButton, Qt.MouseButton.MiddleButton):
            super().mousePressEvent(event)
            return
        shift = bool(event.modifiers() & Qt.KeyboardModifier.ShiftModifier)
        self._drag_from = event.position()
        self._drag_pans = shift or event.button() == Qt.MouseButton.MiddleButton
        self.canvas.setCursor(Qt.CursorShape.SizeAllCursor if self._drag_pans else Qt.CursorShape.ClosedHandCursor)

    def mouseMoveEvent(self, event: QMouseEvent | None) -> None:
        if event is None or self._drag_from is None:
            if event is not None and self._inspects and event.buttons() == Qt.MouseButton.NoButton:
                self._mouse = self.canvas.mapFrom(self, event.position())
                if not self._hover.isActive():
                    self._hover.start()
            super().mouseMoveEvent(event)
            return
        moved = event.position() - self._drag_from
        self._drag_from = event.position()
        if self._drag_pans:
            self.set_camera(self.camera().panned(moved.x(), moved.y(), *self._size()))
        else:
            turn = pi / min(self._size())
            self._orbit(-moved.x() * turn, moved.y() * turn)

    def mouseReleaseEvent(self, event: QMouseEvent | None) -> None:
        self._drag_from = None
        self.canvas.unsetCursor()
        super().mouseReleaseEvent(event)

    def _point(self) -> None:
        self.pointHovered.emit(self.pick(self._mouse))

    def leaveEvent(self, event: QEvent | None) -> None:
        super().leaveEvent(event)
        self._hover.stop()
        self.pointHovered.emit(None)

    def mouseDoubleClickEvent(self, event: QMouseEvent | None) -> None:
        if event is None or event.button() != Qt.MouseButton.LeftButton:
            return
        if self._inspects:
            self.enlargeRequested.emit()
        else:
            self.look_from("reset")

    def wheelEvent(self, event: QWheelEvent | None) -> None:
        if event is None or event.angleDelta().y() == 0:
            super().wheelEvent(event)
            return
        cursor = self.canvas.mapFrom(self, event.position())
        self._zoom(_ZOOM_STEP ** (event.angleDelta().y() / 120), cursor)
        event.accept()

    def _orbit(self, right: float, up: float) -> None:
        self.set_camera(self.camera().orbited(right, up))

    def _zoom(self, factor: float, at: QPointF | None = None) -> None:
        at = at or QPointF(self.canvas.width() / 2, self.canvas.height() / 2)
        self.set_camera(self.camera().zoomed(factor, (at.x(), at.y()), *self._size()))


def link_cameras(views: Sequence[CloudView]) -> None:
    """Let views that are new share one camera."""
    for view in views:
        view._companions = [other for other in views if other is not view]
