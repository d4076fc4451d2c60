"""The clouds and legends of the two views: the scan with its contact, and the patch with the scan's laid over it."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from PyQt6.QtGui import QColor

from ...core.model.arrays import Float64Array, Uint8Array
from ...widgets.basics.colormaps import CONTACT_COLOR, CONTACT_RGB, CONTACT_ROW, Legend, Theme, patch_lut
from ...widgets.clouds.cloud_data import DepthCloud
from ...widgets.clouds.free_points import free_cloud
from ...widgets.clouds.pick_view import Spot
from ...widgets.images.marks import MarkKind
from .truth_patch import FrozenPatch
from .truth_state import PickedPair, Side
from .truth_work import PALETTE, LoadedScan, ScanContact

#: The scan's contact over the patch, in both themes.
SCAN_RGB: Final = (24, 120, 230)
SCAN_COLOR: Final = QColor(*SCAN_RGB)
_SCAN_ROW = CONTACT_ROW - 1
_CONTEXT_ROWS = CONTACT_ROW - 1
#: How bright a highlighted point is, whatever the paint.
_DIMMEST = 0.55


def scan_cloud(loaded: LoadedScan, contact: ScanContact | None, highlight: bool) -> DepthCloud:
    """Return the scan in its own colours, its contact highlighted or not."""
    rows = loaded.rows.copy()
    if contact is not None:
        rows[contact.vertices[loaded.shown]] += np.uint8(PALETTE)
    return free_cloud(loaded.scan.vertices_m[loaded.shown], rows, scan_lut(loaded, highlight))


def highlighted(cloud: DepthCloud, loaded: LoadedScan, highlight: bool) -> DepthCloud:
    """Return the same cloud with its contact highlighted or not."""
    return replace(cloud, lut=scan_lut(loaded, highlight))


def scan_lut(loaded: LoadedScan, highlight: bool) -> Uint8Array:
    """Return the colours of rows: the palette, then the palette of what is in contact: uint8 (256, 4)."""
    lut = np.full((256, 4), 255, np.uint8)
    count = len(loaded.palette)
    lut[:count, :3] = loaded.palette
    lut[PALETTE : PALETTE + count, :3] = loaded.palette
    if highlight:
        light = loaded.palette.max(axis=1, keepdims=True) / 255
        lut[PALETTE : PALETTE + count, :3] = np.rint(np.array(CONTACT_RGB) * (_DIMMEST + (1 - _DIMMEST) * light))
    return lut


def patch_cloud(patch: FrozenPatch, scan_points: Float64Array | None, theme: Theme) -> DepthCloud:
    """Return the patch among what is around it, with the scan's contact where it is posed."""
    depth = patch.context[:, 2]
    near, far = (float(depth.min()), float(depth.max())) if len(depth) else (0.0, 1.0)
    shades = (depth - near) * ((_CONTEXT_ROWS - 1) / max(far - near, 1e-6))
    clouds = [(patch.context, shades.astype(np.uint8)), (patch.points, np.full(len(patch.points), CONTACT_ROW))]
    if scan_points is not None:
        clouds.append((scan_points.astype(np.float32), np.full(len(scan_points), _SCAN_ROW)))
    lut = patch_lut(theme).copy()
    lut[_SCAN_ROW, :3] = SCAN_RGB
    rows = np.concatenate([row for _, row in clouds]).astype(np.uint8)
    return free_cloud(np.concatenate([points for points, _ in clouds]), rows, lut, count=len(patch.points))


def scan_legend(highlight: bool) -> Legend:
    """Return what the colours of the scan's view mean."""
    return [("contact by its paint", CONTACT_COLOR)] if highlight else []


def patch_legend(posed: bool, theme: Theme) -> Legend:
    """Return what the colours of the patch's view mean."""
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
