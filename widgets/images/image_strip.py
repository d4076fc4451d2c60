"""Four linked images of one frame: colour, both depths, relative difference; one at a time, or all with room."""

from __future__ import annotations

from PyQt6.QtCore import QRectF, QSize, Qt, pyqtSignal
from PyQt6.QtGui import QColor, QKeyEvent, QPalette, QResizeEvent
from PyQt6.QtWidgets import QFrame, QGridLayout, QSizePolicy, QTabBar, QWidget

from ..basics.colormaps import CONTACT_RGB, MASKED_RGB, depth_legend, difference_legend
from ..basics.controls import push_button, wrapped_label
from ..basics.layouts import hbox, vbox
from ..basics.overlays import Wipe
from .image_pane import ARROW_KEYS, ZOOM_KEYS, ImagePane, Rectangle, moved_by_arrow
from .marks import RegionItem
from .strip_render import NO_VALUE_RGB, RenderedStrip, difference_limit

#: Name and title of each pane, left to right.
PANES = {
    "color": "Colour + mask",
    "proximity": "Proximity depth",
    "tactile": "Tactile depth (aligned)",
    "difference": "Relative difference",
}
#: Short titles, for the tabs.
TABS = {"color": "Colour", "proximity": "Proximity", "tactile": "Tactile", "difference": "Difference"}
#: The panes that a rig with a tactile camera only does not have, and that of a source without colour images.
_OF_TWO_CAMERAS, _OF_COLOR = {"proximity", "difference"}, {"color"}
#: From this size on, in pixels, all images are shown instead of one with tabs.
_ROOM_FOR_ALL = QSize(640, 400)


class _Banner(QFrame):
    """Says over the top of its parent what to click, with a button *Done*; hidden without words."""

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)
        self.text = wrapped_label()
        self.done = push_button("Done", "End picking (Esc)")
        hbox((self.text, 1), self.done, within=self, margins=(8, 0, 0, 0))  # no higher than the tabs, which it covers
        self.setFrameShape(QFrame.Shape.Box)
        self.setAutoFillBackground(True)
        self.setBackgroundRole(QPalette.ColorRole.ToolTipBase)
        self.hide()

    def show_words(self, words: str) -> None:
        self.text.setText(words)
        self.setAccessibleName(words)
        self.setVisible(bool(words))

    def place(self, left: int, width: int) -> None:
        if not self.isHidden():
            self.setGeometry(left, 0, width, max(self.heightForWidth(width), self.sizeHint().height()))
            self.raise_()


class ImageStrip(QWidget):
    """Shows a `RenderedStrip`; zoom, pan and the crosshair are shared by all panes.

    Keys: arrows move the crosshair (Shift: ten pixels), Enter clicks the colour image there, + and - zoom, 0 shows all.
    """

    hovered = pyqtSignal(int, int)  # u, v: the proximity pixel pointed at; -1, -1 for none
    clicked = pyqtSignal(str, int, int, object)  # key of the pane, u, v, modifiers
    regionEdited = pyqtSignal(object, int)  # region of interest (left, top, width, height), gesture
    wantedChanged = pyqtSignal()  # other images or another resolution are needed; a paused frame is rendered again
    wipeDragged = pyqtSignal(float)  # share: the wipe was dragged in one of the images

    def __init__(self) -> None:
        super().__init__()
        self.panes = {name: ImagePane(title) for name, title in PANES.items()}
        self.regions = {name: RegionItem(pane) for name, pane in self.panes.items()}
        self._size = (640, 480)
        self._pixel = (-1, -1)
        self._legend_key: tuple[object, ...] = ()
        self._fitted = True
        self._linking = False
        self._hint: tuple[int, list[str]] = (0, [])
        self._two_cameras = self._has_color = True
        self._wipe: Wipe | None = None
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setAccessibleName("Images of the current frame")

        self.tabs = QTabBar()
        self.tabs.setAccessibleName("Image")
        self.tabs.setDrawBase(False)
        self.tabs.setExpanding(False)
        self.tabs.setUsesScrollButtons(False)
        self._enlarged = ""
        self._grid = QGridLayout()
        self._grid.setSpacing(4)
        for index, (name, pane) in enumerate(self.panes.items()):
            self.tabs.addTab(TABS[name])
            self.tabs.setTabToolTip(index, PANES[name])
            self._grid.addWidget(pane, index // 2, index % 2)
            self._connect_pane(name, pane)
        self.tabs.currentChanged.connect(lambda _: self.show_panes())
        vbox(self.tabs, (self._grid, 1), within=self, margins=0, spacing=4)
        self.banner = _Banner(self)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self.show_panes()
        self.reset_view()

    def set_images(self, rendered: RenderedStrip | None, right: RenderedStrip | None = None) -> None:
        """Show a rendered frame, or with None that there is none; ``right`` is shown right of the wipe."""
        for name, pane in self.panes.items():
            if rendered is None:
                pane.set_pixels(None, self._size, 1)
            elif name in rendered.panes:  # others are hidden
                pixels = None if right is None else right.panes.get(name)
                pane.set_pixels(rendered.panes[name], rendered.size, rendered.stride, pixels)
        if rendered is None:
            return
        if rendered.size != self._size:
            self._size = rendered.size
            self.reset_view()
        key = (rendered.depth_range_m, rendered.tolerance, rendered.shows_mask)
        if key == self._legend_key:
            return
        self._legend_key = key
        depth = [*depth_legend(*rendered.depth_range_m), ("no depth", QColor(*NO_VALUE_RGB))]
        masked = [("masked", QColor(*MASKED_RGB))] if rendered.shows_mask else []
        self.panes["color"].set_legend([("contact", QColor(*CONTACT_RGB)), *masked])
        self.panes["proximity"].set_legend(depth)
        self.panes["tactile"].set_legend(depth)
        self.panes["difference"].set_legend(difference_legend(rendered.tolerance, difference_limit(rendered.tolerance)))

    def set_wipe(self, wipe: Wipe | None) -> None:
        """Divide every image between two sides, or show only one."""
        if wipe == self._wipe:
            return
        self._wipe = wipe
        for pane in self.panes.values():
            pane.set_wipe(wipe)

    def right_of_wipe(self, u: int) -> bool:
        split = self._shown().split()
        return split is not None and u > split

    def set_two_cameras(self, two: bool) -> None:
        if two != self._two_cameras:
            self._two_cameras = two
            self.panes["tactile"].header.set_title(PANES["tactile"] if two else "Tactile depth")
            self.show_panes()

    def set_color(self, there: bool) -> None:
        if there != self._has_color:
            self._has_color = there
            self.show_panes()

    def choose(self, name: str) -> None:
        """Turn to the image of a name."""
        self.tabs.setCurrentIndex(list(self.panes).index(name))

    def enlarge(self, name: str) -> None:
        """Show only the image of a name, over the whole strip; an empty name ends that."""
        self._enlarged = name
        self.show_panes()

    def show_panes(self) -> None:
        room = self.size()
        absent = (set() if self._two_cameras else _OF_TWO_CAMERAS) | (set() if self._has_color else _OF_COLOR)
        there = [name for name in self.panes if name not in absent]
        for index, name in enumerate(self.panes):
            self.tabs.setTabVisible(index, name in there)
        every = room.width() >= _ROOM_FOR_ALL.width() and room.height() >= _ROOM_FOR_ALL.height()
        chosen = list(self.panes)[max(0, self.tabs.currentIndex())]
        one = chosen if chosen in there else there[0]
        shown = [self._enlarged] if self._enlarged else there if every else [one]
        self.tabs.setVisible(not every and not self._enlarged)
        for name, pane in self.panes.items():
            pane.setVisible(name in shown)
            pane.header.setVisible(self.tabs.isHidden())
            pane.header.show_legend(bool(self._enlarged))
        rows, columns = zip(*(divmod(list(self.panes).index(name), 2) for name in shown), strict=True)
        for place in (0, 1):  # those shown share the room alike
            self._grid.setRowStretch(place, int(place in rows))
            self._grid.setColumnStretch(place, int(place in columns))
        self._check_hint()

    def set_badge(self, text: str) -> None:
        for pane in self.panes.values():
            pane.badge.set_text(text)

    def set_region(self, rectangle: Rectangle | None) -> None:
        """Show the region of interest (left, top, width, height), or none; never emits."""
        for region in self.regions.values():
            region.set_rectangle(rectangle)

    def set_picking(self, words: str) -> None:
        """Say in a banner what to click in the colour image, which gets a picking cursor; empty words end that."""
        self.banner.show_words(words)
        self._place_banner()
        if words:
            self.setFocus()
        shape = Qt.CursorShape.CrossCursor if words else Qt.CursorShape.ArrowCursor
        self.panes["color"].view.viewport().setCursor(shape)

    def width_hint(self) -> int:
        """Return the width of the whole image in screen pixels, for `stride_for`."""
        return max(1, round(max(self.panes[name].scale() for name in self.shown_images()) * self._size[0]))

    def shown_images(self) -> list[str]:
        """Return the names of the images that are shown, at least one: a hidden one has no size of its own."""
        return [name for name, pane in self.panes.items() if not pane.isHidden()]

    def _shown(self) -> ImagePane:
        return self.panes[self.shown_images()[0]]

    def reset_view(self) -> None:
        self._fitted = True
        self._linking = True
        for pane in self.panes.values():
            pane.show_rect(QRectF(-0.5, -0.5, *self._size))
        self._linking = False
        self._check_hint()

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        assert event is not None
        key = Qt.Key(event.key())
        if key in ARROW_KEYS:
            start = self._pixel if self._pixel != (-1, -1) else (self._size[0] // 2, self._size[1] // 2)
            self.point_at(*moved_by_arrow(event, start, self._size))
        elif key in (Qt.Key.Key_Return, Qt.Key.Key_Enter) and self._pixel != (-1, -1):
            self.clicked.emit("color", *self._pixel, event.modifiers())
        elif key in ZOOM_KEYS:
            self._zoom(1 / ZOOM_KEYS[key])
        elif key == Qt.Key.Key_0:
            self.reset_view()
        else:
            super().keyPressEvent(event)

    def _connect_pane(self, name: str, pane: ImagePane) -> None:
        pane.hovered.connect(self.point_at)
        pane.clicked.connect(lambda u, v, modifiers: self.clicked.emit(name, u, v, modifiers))
        pane.viewChanged.connect(lambda rect: self._follow(pane, rect))
        pane.viewMoved.connect(lambda: setattr(self, "_fitted", False))
        pane.box.sigResized.connect(self._pane_resized)
        pane.view.grip.dragged.connect(self.wipeDragged)
        self.regions[name].edited.connect(lambda rectangle, gesture: self._region_edited(name, rectangle, gesture))

    def point_at(self, u: int, v: int) -> None:
        """Put the crosshair on a pixel; -1, -1 hides it."""
        if (u, v) == self._pixel:
            return
        self._pixel = (u, v)
        for pane in self.panes.values():
            pane.set_cross(u, v)
        self.hovered.emit(u, v)

    def _follow(self, leader: ImagePane, rect: QRectF) -> None:
        if self._linking:
            return
        self._linking = True
        for pane in self.panes.values():
            if pane is not leader:
                pane.show_rect(rect)
        self._linking = False
        self._check_hint()

    def _pane_resized(self, *_: object) -> None:
        if self._fitted:
            self.reset_view()

    def resizeEvent(self, event: QResizeEvent | None) -> None:
        super().resizeEvent(event)
        self.show_panes()
        self._place_banner()

    def _place_banner(self) -> None:
        """Put the banner over the other images, or over the tabs of the only one."""
        color = self.panes["color"].geometry()
        left = color.right() + 4 if self.tabs.isHidden() and color.right() < self.width() / 2 else 0
        self.banner.place(left, self.width() - left)

    def _zoom(self, factor: float) -> None:
        self._fitted = False
        box = self._shown().box
        box.scaleBy((factor, factor), center=self._pixel if self._pixel != (-1, -1) else None)

    def _region_edited(self, source: str, rectangle: Rectangle, gesture: int) -> None:
        for name, region in self.regions.items():
            if name != source:
                region.set_rectangle(rectangle)
        self.regionEdited.emit(rectangle, gesture)

    def _check_hint(self) -> None:
        hint = self.width_hint(), self.shown_images()
        if hint != self._hint:
            self._hint = hint
            self.wantedChanged.emit()
