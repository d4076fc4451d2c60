"""The two 3D views of the ground-truth tab: the scan, and the patch with the scan's contact over it."""

from __future__ import annotations

from PyQt6.QtCore import QEvent, Qt, pyqtSignal
from PyQt6.QtWidgets import QHBoxLayout, QLabel, QPushButton, QSplitter, QVBoxLayout, QWidget

from ...widgets.basics.colormaps import palette_theme
from ...widgets.basics.elided_label import ElidedLabel
from ...widgets.clouds.cloud_view import BackendChoice
from ...widgets.clouds.pick_view import PickView, as_place
from ...widgets.clouds.pose_handles import PoseHandles
from .truth_flow import TruthFlow
from .truth_pictures import highlighted, patch_cloud, patch_legend, scan_cloud, scan_legend, spots
from .truth_work import posed

_NO_SCAN = "No scan yet: open a painted PLY or OBJ, or drop it here"
_NO_PATCH = "No patch yet: open a source in the main window and show a frame with contact"


class TruthViews(QSplitter):
    """Draws what a `TruthFlow` holds.

    Signals
    -------
    scanClicked(pixel: int, place: tuple), patchClicked(pixel: int, place: tuple)
        In the scan's own frame, and in the proximity frame.
    presentRequested(), followRequested()
        Align to the main window's present frame; or follow it again.
    """

    scanClicked = pyqtSignal(int, object)
    patchClicked = pyqtSignal(int, object)
    presentRequested = pyqtSignal()
    followRequested = pyqtSignal()

    def __init__(self, flow: TruthFlow, backend: BackendChoice) -> None:
        super().__init__(Qt.Orientation.Horizontal)
        self._flow = flow
        self._highlight = True
        self._selected = -1
        self._drawn: tuple[object, ...] = ()
        self.scan = PickView("Scan", backend)
        self.patch = PickView("Patch", backend)
        self.scan_name = ElidedLabel("no scan")
        self.patch_name = ElidedLabel("no frame")
        self.present = QPushButton("Take present")
        self.present.setToolTip("Align to the frame that the main window shows now; pairs and pose stay")
        self.follow = QPushButton("Follow")
        self.follow.setToolTip("Let the patch follow the main window again, until the next edit of the alignment")
        self._lay_out()
        self.scan.pointClicked.connect(self.scanClicked)
        self.patch.pointClicked.connect(self.patchClicked)
        self.present.clicked.connect(self.presentRequested)
        self.follow.clicked.connect(self.followRequested)
        self.scan.set_message(_NO_SCAN)
        self.patch.set_message(_NO_PATCH)
        self.show_patch()

    def _lay_out(self) -> None:
        self.setChildrenCollapsible(False)
        for view, name, tools in (
            (self.scan, self.scan_name, ()),
            (self.patch, self.patch_name, (self.present, self.follow)),
        ):
            side = QWidget()
            line = QHBoxLayout()
            line.addWidget(QLabel())  # as high as the buttons of the other side
            line.addWidget(name, 1)
            for button in tools:
                button.setAutoDefault(False)
                line.addWidget(button)
            column = QVBoxLayout(side)
            column.setContentsMargins(0, 0, 0, 0)
            column.setSpacing(2)
            column.addLayout(line)
            column.addWidget(view, 1)
            self.addWidget(side)
        height = self.present.sizeHint().height()
        self.scan_name.setMinimumHeight(height)

    def set_highlight(self, on: bool) -> None:
        """Show the contact in its own colour, or the paint as it is."""
        self._highlight = on
        cloud, loaded = self.scan.cloud(), self._flow.loaded
        if cloud is not None and loaded is not None:
            self.scan.set_cloud(highlighted(cloud, loaded, on))
        self.scan.set_legend(scan_legend(on) if loaded is not None else [])

    def set_point_size(self, pixels: int) -> None:
        """Draw points so large; those of a scan a little larger, since its vertices lie farther apart."""
        self.scan.set_point_size(pixels + 1)
        self.patch.set_point_size(pixels)

    def set_dropper(self, in_hand: bool) -> None:
        """Show over the scan that a click takes a colour."""
        self.scan.setCursor(Qt.CursorShape.CrossCursor if in_hand else Qt.CursorShape.ArrowCursor)

    def set_selected(self, number: int) -> None:
        """Mark a pair, from 0; -1: none."""
        self._selected = number
        self.show_marks()

    def show_scan(self, another: bool) -> None:
        """Draw the scan anew; ``another`` one is framed."""
        loaded, contact = self._flow.loaded, self._flow.contact
        if loaded is None:
            return
        self.scan_name.setText(loaded.path.name)
        self.scan.set_cloud(scan_cloud(loaded, contact, self._highlight))
        self.scan.set_legend(scan_legend(self._highlight))
        if another:
            self.scan.look_from("reset")
        self.show_patch()

    def show_patch(self) -> None:
        """Draw the patch, and over it the scan where it has a pose, unless that is what is drawn already."""
        flow = self._flow
        patch, pose, contact = flow.patch, flow.state.pose, flow.contact
        held = flow.state.patch is not None
        self.present.setEnabled(patch is not None)
        self.follow.setEnabled(held)
        if patch is None:
            self._drawn = ()
            self.patch.set_cloud(None)
            self.patch_name.setText("no frame")
            return
        self.patch_name.setText(f"{'Held' if held else 'Live'}: {patch.title}")
        theme = palette_theme(self.palette())
        if self._drawn[:2] == (pose, theme) and self._drawn[2] is patch and self._drawn[3] is contact:
            return
        self._drawn = pose, theme, patch, contact
        over = posed(contact, pose) if pose is not None and contact is not None else None
        self.patch.set_cloud(patch_cloud(patch, over, theme))
        self.patch.set_pickable(len(patch.context) + len(patch.points))
        self.patch.set_legend(patch_legend(over is not None, theme))
        pivot = flow.pivot()
        self.patch.set_handles(None if pivot is None else PoseHandles(as_place(pivot)))

    def show_marks(self) -> None:
        """Draw the marks of both views."""
        pairs = self._flow.state.pairs
        self.scan.set_spots(spots(pairs, "scan", self._selected))
        self.patch.set_spots(spots(pairs, "patch", self._selected))

    def changeEvent(self, event: QEvent | None) -> None:
        """Follow the theme."""
        super().changeEvent(event)
        if event is not None and event.type() == QEvent.Type.PaletteChange and hasattr(self, "present"):
            self.show_patch()
