"""The views: the patch large, both cameras and the images smaller beside it; enlarging one of them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np
from PyQt6.QtCore import QPoint, QSignalBlocker, Qt, pyqtSignal
from PyQt6.QtGui import QPainter, QPixmap
from PyQt6.QtWidgets import QSlider, QWidget

from ...core.contact.pipeline import ContactPatch
from ...core.model.arrays import Float64Array
from ...core.model.patch import Provenance
from ...widgets.basics.colormaps import (
    LATE_VERDICTS,
    Legend,
    behind_legend,
    depth_legend,
    patch_legend,
    pressure_legend,
    provenance_legend,
)
from ...widgets.basics.controls import ChoiceBox, caption, named
from ...widgets.basics.layouts import STRETCH, hbox, holding, splitter, vbox
from ...widgets.basics.overlays import Wipe
from ...widgets.basics.theme import ThemeName
from ...widgets.clouds.cloud_data import DepthCloud
from ...widgets.clouds.cloud_view import CloudView, link_cameras
from ...widgets.clouds.view_camera import VIEWPOINTS
from ...widgets.images.image_strip import ImageStrip
from ..worker.results import CloudName, ColorBy, ComparedSide, Rendered, Result, SourceInfo
from .actions import Actions

TITLES = {
    CloudName.PROXIMITY: "Proximity",
    CloudName.TACTILE: "Tactile",
    CloudName.PATCH: "Contact patch",
}
POINT_SIZES = (1, 8)
#: Shares of the width: both cameras with the images below them, and the patch.
_PATCH_SHARE = (0.45, 0.55)
#: Share of a view that the patch takes after *Zoom to patch*.
_PATCH_FILL = 0.6
_NO_DEPTH = "This camera measured no depth in this frame"
_NO_POSE = "Its pose is not known: calibrate the alignment"
_READINGS_TIP = "<p><b>touches</b>: how likely the membrane touches; <b>boundary</b>: expected error of its place.</p>"
_COLOR_TIPS = {
    ColorBy.CONTACT: "Depth in the camera views; contact in its own colour in the patch, hatched where doubtful",
    ColorBy.PROVENANCE: "Proximity: why each point was kept or dropped. Patch: what the last steps dropped",
    ColorBy.PRESSURE: "Contact pressure on the membrane and the patch, in kPa, or relative to an unknown inflation",
}
_COLORS_TIP = "What the colours of the points mean"
_NO_PRESSURE = f"{_COLORS_TIP}. Pressure is a choice with the contact test pressure"


class ViewArea(QWidget):
    """Both cameras and the images at the left, the patch at the right; orbit one cloud and all follow.

    A double click gives the patch's place to a view or an image, and the patch takes the other place; another double
    click puts both back. What is hidden is not drawn.
    """

    wantedChanged = pyqtSignal()  # the colours were changed, or a view was shown or hidden
    wipeDragged = pyqtSignal(float)  # to this share of the width, in one of the views

    def __init__(self, actions: Actions, strip: ImageStrip) -> None:
        super().__init__()
        self.views = {name: CloudView(title, inspects=True) for name, title in TITLES.items()}
        patch = self.views[CloudName.PATCH]
        patch.help = _READINGS_TIP + patch.help
        self.strip = strip
        self.toggles = {name: actions.by_name()[f"show_{name}"] for name in CloudName}
        self._actions = actions
        self._result: Result | None = None
        self._framed: SourceInfo | None = None
        self._two_cameras = True
        #: The view or image in the large place.
        self.large: QWidget = self.views[CloudName.PATCH]
        link_cameras(list(self.views.values()))
        for view in self.views.values():
            view.wipeDragged.connect(self.wipeDragged)
            view.find_focus = self._focus
        self.color_by = ChoiceBox()
        self.color_by.setAccessibleName("Colour by")
        self.colors = ColorBy.CONTACT  # as chosen, also while the frames on the screen have no pressure
        self._offer_colors(with_pressure=False)
        self.color_by.currentIndexChanged.connect(lambda _: self.choose_colors(self.color_by.currentData()))
        tip = "Point size in pixels; larger where that closes gaps"
        self.point_size = named(QSlider(Qt.Orientation.Horizontal), "Point size", tip)
        self.point_size.setRange(*POINT_SIZES)
        self.point_size.setValue(2)
        self.point_size.setFixedWidth(60)
        self.point_size.valueChanged.connect(self._resize_points)
        self._lay_out()
        for action in (*self.toggles.values(), actions.show_strip):
            action.toggled.connect(lambda _: self.enlarge(self.views[CloudName.PATCH]))
        for view in self.views.values():
            view.enlargeRequested.connect(partial(self.enlarge, view))
        for pane in strip.panes.values():
            pane.doubleClicked.connect(partial(self.enlarge, pane))
        for viewpoint in VIEWPOINTS:
            action = actions.by_name()[f"{viewpoint}_view"]
            action.triggered.connect(lambda _, viewpoint=viewpoint: self._any_view().look_from(viewpoint))
        actions.zoom_to_patch.triggered.connect(self._zoom_to_patch)
        actions.zoom_to_patch.setEnabled(False)
        self._resize_points(self.point_size.value())
        self._show_large()

    def _lay_out(self) -> None:
        color_by, point_size = caption("&Colour", self.color_by), caption("Si&ze", self.point_size)
        row = hbox(*(color_by, self.color_by, 8, point_size, self.point_size, STRETCH), margins=(4, 0, 4, 0), spacing=4)
        *cameras, patch = self.views.values()
        self._cameras = splitter(Qt.Orientation.Horizontal, *((view, 1) for view in cameras))
        self._rows = splitter(Qt.Orientation.Vertical, (self._cameras, 1), (self.strip, 1))
        self._side = holding(vbox(row, (self._rows, 1), margins=0, spacing=4))
        self._across = splitter(Qt.Orientation.Horizontal, (self._side, 1), (patch, 1))
        vbox(self._across, within=self, margins=0)
        of_cameras = [(self._cameras, number, view) for number, view in enumerate(cameras)]
        #: Where each part stands while the patch is the large one.
        self._places = [*of_cameras, (self._rows, 1, self.strip), (self._across, 1, patch)]
        self.splitters = {"views/cameras": self._cameras, "views/rows": self._rows, "views/across": self._across}

    def share_room(self) -> None:
        """Give each view its share of the room: the patch has more than twice the area of any other."""
        self._across.setSizes([round(share * 10_000) for share in _PATCH_SHARE])
        self._rows.setSizes([5_000, 5_000])
        self._cameras.setSizes([5_000, 5_000])

    def enlarge(self, part: QWidget) -> None:
        """Let the patch change places with a view or an image, or put the large one back."""
        self.large = self.views[CloudName.PATCH] if part is self.large else part
        self._arrange()

    def back(self) -> bool:
        """Give the patch its place again; return whether another part had it."""
        if self.large is self.views[CloudName.PATCH]:
            return False
        self.enlarge(self.large)
        return True

    def _arrange(self) -> None:
        patch = self.views[CloudName.PATCH]
        image = next((name for name, pane in self.strip.panes.items() if pane is self.large), "")
        large = self.strip if image else self.large
        sizes = [each.saveState() for each in self.splitters.values()]
        for room, place, own in self._places:
            part = large if own is patch else patch if own is large else own
            if room.widget(place) is not part:
                room.insertWidget(place, part)
        for each, state in zip(self.splitters.values(), sizes, strict=True):
            each.restoreState(state)
        for name, view in self.views.items():
            view.setVisible(self.chosen(name))
        self.strip.enlarge(image)
        self.strip.setVisible(bool(image) or self._actions.show_strip.isChecked())
        for room, shown in ((self._cameras, self._cameras), (self._rows, self._side)):
            shown.setVisible(any(part is not None and not part.isHidden() for part in map(room.widget, (0, 1))))
        self._show_large()
        self.wantedChanged.emit()

    def choose_colors(self, choice: ColorBy) -> None:
        self.colors = choice
        with QSignalBlocker(self.color_by):
            self.color_by.setCurrentIndex(max(0, self.color_by.findData(choice)))
        self.wantedChanged.emit()

    def _offer_colors(self, with_pressure: bool) -> None:
        with QSignalBlocker(self.color_by):
            self.color_by.clear()
            for number, choice in enumerate(each for each in ColorBy if with_pressure or each != ColorBy.PRESSURE):
                self.color_by.addItem(choice.value.capitalize(), choice)
                self.color_by.setItemData(number, _COLOR_TIPS[choice], Qt.ItemDataRole.ToolTipRole)
            self.color_by.setCurrentIndex(max(0, self.color_by.findData(self.colors)))
        self.color_by.setToolTip(_COLORS_TIP if with_pressure else _NO_PRESSURE)

    def visible_clouds(self) -> frozenset[CloudName]:
        return frozenset(name for name, view in self.views.items() if not view.isHidden())

    def show_result(self, result: Result, theme: ThemeName, wipe: Wipe | None = None) -> None:
        """Show the clouds of a result with their legends, of two compared presets on both sides of the wipe."""
        self._result = result
        self._actions.zoom_to_patch.setEnabled(result.patch is not None and len(result.patch.points) > 0)
        self.set_wipe(wipe)
        sides = (result,) if result.compared is None else (result.compared.a, result.compared.b)
        with_pressure = any(side.patch is not None and side.patch.pressure is not None for side in sides)
        if with_pressure != (self.color_by.findData(ColorBy.PRESSURE) >= 0):
            self._offer_colors(with_pressure)
        self.views[CloudName.PATCH].set_arrow(result.force_arrow_m if result.compared is None else None)
        for view in self.views.values():
            view.set_running(result.playback.playing)
        for name in sides[0].rendered.clouds:
            (cloud, message), *right = (_shown(name, side) for side in sides)
            legends = [legend_of(name, side.rendered, theme) for side in sides]
            others = [entry for entry in legends[-1] if entry not in legends[0]]
            view = self.views[name]
            view.set_cloud(cloud)
            view.set_message(message)
            view.header.set_entries(legends[0] + others if cloud is not None else [])
            for other in right:
                view.set_right(*other)
        if result.source is not self._framed:  # once for each source, so that playing never moves the camera
            self._framed = result.source
            self._any_view().refocus()

    def _focus(self) -> Float64Array:
        return np.empty((0, 3)) if self._result is None else membrane_and_patch(self._result)

    def _zoom_to_patch(self) -> None:
        points = patch_points(None if self._result is None else self._result.patch)
        if len(points):
            self._any_view().zoom_to(points, _PATCH_FILL)

    def set_wipe(self, wipe: Wipe | None) -> None:
        for view in self.views.values():
            view.set_wipe(wipe)

    def show_badges(self, badges: Mapping[CloudName, str]) -> None:
        for name, view in self.views.items():
            view.badge.set_text(badges.get(name, ""))

    def show_message(self, message: str) -> None:
        self.set_wipe(None)
        for view in self.views.values():
            view.set_cloud(None)
            view.set_message(message)

    def _show_large(self) -> None:
        """Let the large view alone show legend and axes; the others have the same colours and directions."""
        for view in self.views.values():
            view.set_large(view is self.large or self.large.isHidden())

    def set_two_cameras(self, two: bool) -> None:
        """Leave out the view of a camera that the rig does not have."""
        if two != self._two_cameras:
            self._two_cameras = two
            self._arrange()

    def chosen(self, name: CloudName) -> bool:
        """Return whether a view is wanted, and the rig has its camera."""
        return self.toggles[name].isChecked() and (self._two_cameras or name is not CloudName.PROXIMITY)

    def _resize_points(self, size: int) -> None:
        for view in self.views.values():
            view.set_point_size(size)

    def _any_view(self) -> CloudView:
        return next((view for view in self.views.values() if not view.isHidden()), self.views[CloudName.PATCH])

    def picture(self) -> QPixmap:
        """Return the views and images without the controls between them."""
        ratio = self.devicePixelRatioF()
        picture = QPixmap((self.size().toSizeF() * ratio).toSize())
        picture.setDevicePixelRatio(ratio)
        picture.fill(self.palette().window().color())
        painter = QPainter(picture)
        for part in (*self.views.values(), *self.strip.panes.values()):
            if part.isVisible():
                painter.drawPixmap(part.mapTo(self, QPoint()), part.grab())
        painter.end()
        return picture

    def restore(self, point_size: str, color_by: str) -> None:
        if color_by in list(ColorBy):
            self.choose_colors(ColorBy(color_by))
        if point_size.isdecimal():
            self.point_size.setValue(min(int(point_size), POINT_SIZES[1]))


def legend_of(name: CloudName, rendered: Rendered, theme: ThemeName) -> Legend:
    color_by, verdicts = rendered.color_by, rendered.verdicts
    if color_by is ColorBy.PRESSURE and name is not CloudName.PROXIMITY:
        legend = pressure_legend(theme, *rendered.pressure_scale)
        return legend + patch_legend(theme)[1:] if name is CloudName.PATCH else legend
    if name is CloudName.TACTILE:
        return depth_legend(*rendered.tactile_range_m)
    if color_by is ColorBy.PROVENANCE and verdicts:
        if name is CloudName.PROXIMITY:
            return provenance_legend(theme, verdicts - {Provenance.NO_PROXIMITY_DEPTH})
        return provenance_legend(theme, verdicts & {*LATE_VERDICTS}) + patch_legend(theme)[1:]
    if name is CloudName.PROXIMITY:
        return depth_legend(*rendered.depth_range_m) + behind_legend()
    return patch_legend(theme)


def _shown(name: CloudName, result: Result | ComparedSide) -> tuple[DepthCloud | None, str]:
    """Return the cloud of a view, and why it has no points and what to do."""
    cloud = result.rendered.clouds[name]
    if name is CloudName.TACTILE and cloud is None:
        return cloud, _NO_POSE
    if name is not CloudName.PATCH:
        return cloud, _NO_DEPTH
    return cloud, result.problem or result.rendered.no_contact


#: Rows of the tactile image that are enough for framing.
_ROWS = 60
#: Depths farther than this many interquartile ranges outside the quartiles are not the membrane (Tukey's fences,
#: "Exploratory Data Analysis", 1977); the slack in metres keeps a flat membrane whole.
_FENCE, _SLACK_M = 1.5, 0.01


def membrane_and_patch(result: Result) -> Float64Array:
    """Return points on the membrane and in the patch: float64 (N, 3), metres, proximity frame; (0, 3) if unknown."""
    patch, cloud = patch_points(result.patch), result.rendered.clouds.get(CloudName.TACTILE)
    membrane = np.empty((0, 3)) if cloud is None else cloud.points(max(1, len(cloud.depth) // _ROWS))
    if not len(membrane):
        return patch
    low, high = np.percentile(membrane[:, 2], (25, 75))
    reach = (0.5 + _FENCE) * (high - low) + _SLACK_M
    return np.concatenate([membrane[np.abs(membrane[:, 2] - (low + high) / 2) <= reach], patch])


def patch_points(patch: ContactPatch | None) -> Float64Array:
    return np.empty((0, 3)) if patch is None else patch.points.astype(np.float64)
