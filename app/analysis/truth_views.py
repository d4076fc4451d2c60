"""Views of the ground-truth tab: the scan, the patch, and how they are drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from PyQt6.QtCore import QEvent, Qt
from PyQt6.QtGui import QColor
from PyQt6.QtWidgets import QSplitter, QWidget

from ...core.model.arrays import Float64Array, Uint8Array
from ...widgets.basics.colormaps import CONTACT_COLOR, CONTACT_RGB, CONTACT_ROW, Legend, Theme, palette_theme, patch_lut
from ...widgets.basics.controls import ElidedLabel, push_button
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from ...widgets.clouds.cloud_data import DepthCloud, free_cloud
from ...widgets.clouds.cloud_view import as_place
from ...widgets.clouds.pick_view import PickView, Spot
from ...widgets.clouds.pose_handles import PoseHandles
from ...widgets.images.marks import MarkKind
from .truth_flow import TruthFlow
from .truth_state import FrozenPatch, PickedPair, Side
from .truth_work import PALETTE, LoadedScan, ScanContact, posed

Rgb = tuple[int, int, int]

#: Colour of the scan's contact over the patch, in both themes.
SCAN_RGB: Final[Rgb] = (24, 120, 230)
SCAN_COLOR: Final = QColor(*SCAN_RGB)
#: Brightness of highlighted points.
_DIMMEST = 0.55


def scan_cloud(loaded: LoadedScan, contact: ScanContact | None, highlight: bool) -> DepthCloud:
    """Return the scan in its own colours, with its contact highlighted or not."""
    rows = loaded.rows.copy()
    if contact is not None:
        rows[contact.vertices[loaded.shown]] += np.uint8(PALETTE)
    return free_cloud(loaded.scan.vertices_m[loaded.shown], rows, scan_lut(loaded, highlight))


def highlighted(cloud: DepthCloud, loaded: LoadedScan, highlight: bool) -> DepthCloud:
    """Return the same cloud with its contact highlighted or not."""
    return replace(cloud, lut=scan_lut(loaded, highlight))


def scan_lut(loaded: LoadedScan, highlight: bool) -> Uint8Array:
    """Return the lookup table: the palette, then the palette of contact: uint8 (256, 4)."""
    lut = np.full((256, 4), 255, np.uint8)
    count = len(loaded.palette)
    lut[:count, :3] = loaded.palette
    lut[PALETTE : PALETTE + count, :3] = loaded.palette
    if highlight:
        light = loaded.palette.max(axis=1, keepdims=True) / 255
        lut[PALETTE : PALETTE + count, :3] = np.rint(np.array(CONTACT_RGB) * (_DIMMEST + (1 - _DIMMEST) * light))
    return lut


def patch_cloud(patch: FrozenPatch, over: Sequence[tuple[Float64Array, Rgb]], theme: Theme) -> DepthCloud:
    """Return the patch with its surroundings, and other points over it, each group in a colour of its own."""
    depth, context_rows = patch.context[:, 2], CONTACT_ROW - len(over)
    near, far = (float(depth.min()), float(depth.max())) if len(depth) else (0.0, 1.0)
    shades = (depth - near) * ((context_rows - 1) / max(far - near, 1e-6))
    clouds = [(patch.context, shades.astype(np.uint8)), (patch.points, np.full(len(patch.points), CONTACT_ROW))]
    lut = patch_lut(theme).copy()
    for row, (points, rgb) in enumerate(over, context_rows):
        clouds.append((points.astype(np.float32), np.full(len(points), row)))
        lut[row] = *rgb, 255
    rows = np.concatenate([row for _, row in clouds]).astype(np.uint8)
    return free_cloud(np.concatenate([points for points, _ in clouds]), rows, lut, count=len(patch.points))


def scan_legend(highlight: bool) -> Legend:
    """Return the legend of the scan's view."""
    return [("painted contact", CONTACT_COLOR)] if highlight else []


def patch_legend(posed: bool, theme: Theme) -> Legend:
    """Return the legend of the patch's view."""
    around = QColor(*(int(channel) for channel in patch_lut(theme)[CONTACT_ROW // 2, :3]))
    scan = [("the scan's contact", SCAN_COLOR)] if posed else []
    return [("patch", CONTACT_COLOR), *scan, ("around it", around)]


def spots(pairs: tuple[PickedPair, ...], side: Side, selected: int | None) -> list[Spot]:
    """Return the marks of one view."""
    marks = []
    for number, pair in enumerate(pairs):
        place = pair.scan if side == "scan" else pair.patch
        if place is not None:
            kind = MarkKind.POINT if pair.complete else MarkKind.PENDING
            marks.append(Spot(place, str(number + 1), kind, number == selected))
    return marks


_NO_SCAN = "No scan yet: open a painted PLY or OBJ, or drop it here"
_NO_PATCH = "No patch yet: show a frame with contact in the main window"


class TruthViews(QSplitter):
    """Draws what a `TruthFlow` holds."""

    def __init__(self, flow: TruthFlow) -> None:
        super().__init__(Qt.Orientation.Horizontal)
        self._flow = flow
        self._highlight = True
        self._selected = -1
        self._drawn: tuple[object, ...] = ()
        self.scan = PickView("Scan")
        self.patch = PickView("Patch")
        self.scan_name = ElidedLabel("no scan")
        self.patch_name = ElidedLabel("no frame")
        self.present = push_button("Use current", "Align to the main window's current frame; pairs and pose stay")
        self.follow = push_button("Follow", "Follow the main window again, until the next edit of the alignment")
        self._lay_out()
        self.scan.set_message(_NO_SCAN)
        self.patch.set_message(_NO_PATCH)
        self.show_patch()

    def _lay_out(self) -> None:
        self.setChildrenCollapsible(False)
        for view, name, tools in (
            (self.scan, self.scan_name, self.present.sizeHint().height() + 4),
            (self.patch, self.patch_name, hbox(self.present, self.follow, STRETCH)),
        ):
            side = QWidget()
            vbox(name, tools, (view, 1), within=side, margins=0, spacing=4)
            self.addWidget(side)

    def set_highlight(self, on: bool) -> None:
        """Show the contact in its own colour, or the paint."""
        self._highlight = on
        cloud, loaded = self.scan.cloud(), self._flow.loaded
        if cloud is not None and loaded is not None:
            self.scan.set_cloud(highlighted(cloud, loaded, on))
        self.scan.set_legend(scan_legend(on) if loaded is not None else [])

    def set_point_size(self, pixels: int) -> None:
        """Set the size of the points; a scan's points are larger, because its vertices are farther apart."""
        self.scan.set_point_size(pixels + 1)
        self.patch.set_point_size(pixels)

    def set_dropper(self, in_hand: bool) -> None:
        """Show the eyedropper's cursor over the scan."""
        self.scan.setCursor(Qt.CursorShape.CrossCursor if in_hand else Qt.CursorShape.ArrowCursor)

    def set_selected(self, number: int) -> None:
        """Mark a pair by its index; -1 marks none."""
        self._selected = number
        self.show_marks()

    def show_scan(self, another: bool) -> None:
        """Draw the scan again, and frame it if it is ``another`` one."""
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
        """Draw the patch, and the scan over it if it has a pose, unless both are drawn already."""
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
        over = [(posed(contact, pose), SCAN_RGB)] if pose is not None and contact is not None else []
        self.patch.set_cloud(patch_cloud(patch, over, theme))
        self.patch.set_pickable(len(patch.context) + len(patch.points))
        self.patch.set_legend(patch_legend(bool(over), theme))
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
