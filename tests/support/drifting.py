"""The simulator before and after a mishap: a camera has moved, or the pressure has changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from tactune.core.calibration.snapshots import take_snapshot
from tactune.core.model.arrays import Float64Array
from tactune.core.model.frames import Rig, SensorFrame
from tactune.core.output.writer import SessionWriter
from tactune.core.sources.base import CameraRole, Progress
from tactune.core.sources.presets import load_preset
from tactune.core.sources.simulator.membrane import Membrane
from tactune.core.sources.simulator.render import Camera
from tactune.core.sources.simulator.scene import Press, cameras
from tactune.core.sources.simulator.scenes import Scene, Variant
from tactune.core.sources.simulator.simulator_source import SimulatorSource, SolvedScene


@dataclass(frozen=True)
class Drift:
    """What has happened since calibration: a camera was shifted along its own axes, or the apex has grown."""

    camera: CameraRole = "tactile"
    shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    apex_m: float = 0.0

    @property
    def motion(self) -> Float64Array:
        """How points move in the camera's frame, 4 x 4: opposite to the camera."""
        moved = np.eye(4)
        moved[:3, 3] = np.negative(self.shift_m)
        return moved


class _DriftedPress(Press):
    """A press, seen after one camera has moved."""

    def __init__(self, scene: Scene, membrane: Membrane, rig: Rig, drift: Drift) -> None:
        super().__init__(scene, membrane, rig)
        near, tactile, color = cameras(rig)
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
        moved = "_".join(f"{number:g}" for number in drift.shift_m)
        design = replace(scene.design, apex_m=scene.design.apex_m + drift.apex_m)
        return super()._solve(
            replace(scene, name=f"{scene.name}-{drift.camera}_{moved}-drifted", design=design), progress
        )

    def _press(self, scene: Scene) -> Press:
        return _DriftedPress(scene, Membrane(scene.design), self.rig, self.drift)


#: Frames of a still scene that go into the untouched frame; later ones have other noise.
AVERAGED = 15


@lru_cache(maxsize=16)
def drifted(drift: Drift | None = None, press: str = "none") -> DriftedSimulator:
    variant = Variant(press=press)
    return DriftedSimulator(drift or Drift(), scene="cup", variant=variant, cells=(60, 36))


@cache
def untouched() -> SensorFrame:
    rest = drifted()
    return take_snapshot([rest.read(index) for index in range(AVERAGED)]).frame


def record_looks(path: Path, sources: Sequence[DriftedSimulator]) -> None:
    """Write one frame of each source, ten seconds apart, with preset and untouched frame."""
    with SessionWriter(path, sources[0].rig, preset=load_preset("simulator"), untouched=untouched()) as writer:
        for number, source in enumerate(sources):
            time_s = 10.0 * number
            frame = source.read(AVERAGED + number)
            writer.put(
                replace(frame, sequence=number, proximity_time_s=time_s, tactile_time_s=time_s, truth=None), wait=True
            )
