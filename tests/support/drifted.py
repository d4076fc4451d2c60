"""The simulator after a mishap: a camera has moved, or the pressure has changed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from tactune.core.model.arrays import Float64Array
from tactune.core.model.frames import Rig
from tactune.core.sources.base import CameraRole, Progress
from tactune.core.sources.simulator.membrane import Membrane
from tactune.core.sources.simulator.render import Camera
from tactune.core.sources.simulator.scene import Press, cameras
from tactune.core.sources.simulator.scenes import Scene
from tactune.core.sources.simulator.source import SimulatorSource, SolvedScene


@dataclass(frozen=True)
class Drift:
    """What has happened since calibration: a camera was shifted or turned about its own axes, or the apex has grown."""

    camera: CameraRole = "tactile"
    shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    apex_m: float = 0.0

    @property
    def motion(self) -> Float64Array:
        """How points move in the camera's frame, 4 x 4: opposite to the camera."""
        moved = np.eye(4)
        moved[:3, :3] = cv2.Rodrigues(np.radians(self.turn_deg))[0]
        moved[:3, 3] = self.shift_m
        return np.asarray(np.linalg.inv(moved))


class _DriftedPress(Press):
    """A press, seen after one camera has moved."""

    def __init__(self, scene: Scene, membrane: Membrane, rig: Rig, drift: Drift) -> None:
        super().__init__(scene, membrane, rig)
        near, tactile, color = cameras(rig, membrane.design)
        if drift.camera == "tactile":
            tactile = _moved(tactile, drift.motion)
        else:
            assert rig.proximity_color is not None
            T_color_depth = np.array(rig.proximity_color.T_color_depth)
            near = _moved(near, drift.motion)
            color = _moved(color, T_color_depth @ drift.motion @ np.linalg.inv(T_color_depth))
        self._cameras = near, tactile, color


def _moved(camera: Camera, motion: Float64Array) -> Camera:
    pose = motion @ np.vstack([camera.pose, (0.0, 0.0, 0.0, 1.0)])
    return replace(camera, pose=np.ascontiguousarray(pose[:3]))


class DriftedSimulator(SimulatorSource):
    """The simulated sensor after a `Drift`; its rig is still the one from before."""

    def __init__(self, drift: Drift, **options: Any) -> None:
        self.drift = drift
        super().__init__(**options)

    def _solve(self, scene: Scene, progress: Progress) -> SolvedScene:
        drift = self.drift
        moved = "_".join(f"{number:g}" for number in (*drift.shift_m, *drift.turn_deg))
        design = replace(scene.design, apex_m=scene.design.apex_m + drift.apex_m)
        return super()._solve(
            replace(scene, name=f"{scene.name}-{drift.camera}_{moved}-drifted", design=design), progress
        )

    def _press(self, scene: Scene) -> Press:
        return _DriftedPress(scene, Membrane(scene.design), self.rig, self.drift)
