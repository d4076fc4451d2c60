"""Views and numbers of the tab Track: the model, the patch with the model in its pose, and the pose."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from PyQt6.QtCore import Qt
from PyQt6.QtGui import QColor
from PyQt6.QtWidgets import QGridLayout, QLabel, QSplitter, QWidget
from scipy.spatial.transform import Rotation

from ...core.errors import minus
from ...core.estimation.pose import PoseEstimate
from ...widgets.basics.colormaps import CONTACT_COLOR, Legend, palette_theme, patch_lut
from ...widgets.basics.controls import CollapsibleSection, ElidedLabel, push_button
from ...widgets.basics.layouts import hbox, vbox
from ...widgets.basics.theme import theme_colors
from ...widgets.clouds.cloud_data import free_cloud
from ...widgets.clouds.cloud_view import as_place
from ...widgets.clouds.pick_view import PickView
from ...widgets.clouds.pose_handles import PoseHandles
from .track_work import FREE_RGB, MODEL_RGB, Model, axes_of
from .truth_state import FrozenPatch, TruthState
from .truth_views import patch_cloud, spots

#: A component with a larger standard deviation is not determined, metres and radians.
_FREE_M, _FREE_RAD = 0.02, 0.3


class PosePanel(CollapsibleSection):
    """The pose with standard deviations; components that the patch does not determine are red."""

    _ROWS: Final = ("x", "y", "z", "roll", "pitch", "yaw")

    def __init__(self) -> None:
        super().__init__("Pose in the proximity frame")
        self.values = [QLabel() for _ in self._ROWS]
        self.sigmas = [QLabel() for _ in self._ROWS]
        self.fit = ElidedLabel()
        grid = QGridLayout()
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setHorizontalSpacing(12)
        for row, name in enumerate(self._ROWS):
            column = 3 * (row // 3)
            about = (
                f"rotation about the camera's {'xyz'[row - 3]} axis, degrees"
                if row > 2
                else "position of the mesh's origin, mm"
            )
            tip = f"{name}: {about}, and its standard deviation; red: the patch does not determine it"
            for offset, label in enumerate((QLabel(name), self.values[row], self.sigmas[row])):
                label.setToolTip(tip)
                if offset:
                    label.setAlignment(Qt.AlignmentFlag.AlignRight)
                    label.setAccessibleName(f"{name}{' standard deviation' if offset == 2 else ''}")
                grid.addWidget(label, row % 3, column + offset)
        for column in (1, 2, 4, 5):
            grid.setColumnStretch(column, 1)
        grid.addWidget(self.fit, 3, 0, 1, 6)
        vbox(grid, within=self.body, margins=(8, 4, 8, 8))

    def show_estimate(self, estimate: PoseEstimate | None) -> None:
        """Show an estimate; None and a lost one have no numbers."""
        if estimate is None or estimate.lost:
            for label in (*self.values, *self.sigmas):
                label.setText("–")
                label.setStyleSheet("")
            self.fit.setText("No pose yet" if estimate is None else "Lost")
            return
        pose, spread = estimate.T_proximity_object, np.sqrt(np.diag(estimate.covariance))
        turns = Rotation.from_matrix(pose[:3, :3]).as_euler("xyz", degrees=True)
        for row, value in enumerate((*1e3 * pose[:3, 3], *turns)):
            length = row < 3
            free = spread[row] > (_FREE_M if length else _FREE_RAD)
            shown = 1e3 * spread[row] if length else math.degrees(spread[row])
            unit = " mm" if length else "°"
            self.values[row].setText(minus(f"{value:z.1f}{unit}"))
            self.sigmas[row].setText("free" if free else f"± {shown:.2f}{unit}")
            color = f"color: {theme_colors().error}" if free else ""
            for label in (self.values[row], self.sigmas[row]):
                label.setStyleSheet(color)
        self.fit.setText(f"Residual {1e3 * estimate.residual_m:.2f} mm, {100 * estimate.overlap:.0f} % on the model")


class TrackViews(QSplitter):
    """The model, and the patch with the model over it."""

    def __init__(self, model: PickView, scene: PickView) -> None:
        super().__init__(Qt.Orientation.Vertical)
        self.model, self.scene = model, scene
        self.name = ElidedLabel("no frame")
        self.follow = push_button(
            "Follow", "Show the main window's frames again instead of the one that was clicked on"
        )
        self._selected = -1
        self._state = TruthState()
        self._framed = False
        self.setChildrenCollapsible(False)
        side = QWidget()
        line = hbox((self.name, 1), self.follow)
        vbox(line, (scene, 1), within=side, margins=0, spacing=4)
        self.addWidget(model)
        self.addWidget(side)
        self.setStretchFactor(0, 1)
        self.setStretchFactor(1, 2)
        model.set_message("No mesh yet: open OBJ, PLY or STL, or drop it here")
        scene.set_message("No patch yet: show a frame with contact in the main window")
        for view in (model, scene):
            view.set_point_size(2)

    def show_model(self, model: Model) -> None:
        """Draw another model; its first pose is framed."""
        self._framed = False
        rows = np.concatenate([np.full(len(points), row, np.uint8) for row, (points, _) in enumerate(model.groups)])
        lut = np.full((256, 4), 255, np.uint8)
        for row, (_, rgb) in enumerate(model.groups):
            lut[row, :3] = rgb
        self.model.set_cloud(free_cloud(np.concatenate([points for points, _ in model.groups]), rows, lut))
        self.model.look_from("reset")

    def select(self, number: int) -> None:
        """Mark a pair; -1: none."""
        self._selected = number
        self._show_marks()

    def show_patch(
        self,
        patch: FrozenPatch | None,
        model: Model | None,
        state: TruthState,
        estimate: PoseEstimate | None,
        tracking: bool,
    ) -> None:
        """Draw a patch, the model in its tracked or start pose, and the directions that are free."""
        self._state = TruthState() if tracking else state
        self._show_marks()
        held = state.patch is not None and not tracking
        self.follow.setEnabled(held)
        if patch is None:
            self.scene.set_cloud(None)
            return
        self.name.setText(f"{'Held' if held else 'Live'}: {patch.title}")
        pose = state.pose if estimate is None else estimate.T_proximity_object
        over = []
        if model is not None and pose is not None and not (estimate is not None and estimate.lost):
            over = model.posed(pose) + ([] if estimate is None else axes_of(estimate, model.mesh))
        theme = palette_theme(self.palette())
        self.scene.set_cloud(patch_cloud(patch, over, theme))
        if over and not self._framed:
            self._framed = True
            self.scene.fit()
        self.scene.set_pickable(len(patch.context) + len(patch.points))
        around = QColor(*(int(channel) for channel in patch_lut(theme)[128, :3]))
        legend: Legend = [("patch", CONTACT_COLOR), ("around it", around)]
        legend += [("model", QColor(*MODEL_RGB))] if over else []
        legend += [("free direction", QColor(*FREE_RGB))] if over and estimate is not None and estimate.free else []
        self.scene.set_legend(legend)
        centre = model.centre(state.pose) if model is not None and state.pose is not None and not tracking else None
        self.scene.set_handles(None if centre is None else PoseHandles(as_place(centre)))

    def _show_marks(self) -> None:
        self.model.set_spots(spots(self._state.pairs, "scan", self._selected))
        self.scene.set_spots(spots(self._state.pairs, "patch", self._selected))
