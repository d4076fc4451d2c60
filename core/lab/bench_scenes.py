"""The frames that engines are measured on: simulated presses, and synthetic contacts of a given size."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np

from ..errors import TactuneError
from ..model.arrays import Float64Array, Uint16Array
from ..model.frames import DepthCamera, GroundTruth, Rig, SensorFrame
from ..model.intrinsics import Intrinsics
from ..preset import Preset
from ..sources.presets import load_preset

#: Depths of the simulated presses, metres past first touch.
LIGHT_M, MEDIUM_M = 0.003, 0.024

#: Engines are variants of this contact test.
_TEST: Final = {"contact_test": "tolerance"}
_CONTACT_RGB = (172, 168, 160)
_MEMBRANE_RGB = (36, 96, 190)


@dataclass(frozen=True, eq=False)
class BenchScene:
    """One frame with its rig and the preset it is processed with."""

    name: str
    rig: Rig
    preset: Preset
    frame: SensorFrame


def scene_names() -> tuple[str, ...]:
    """Return the names of all scenes, from no contact to full contact."""
    return tuple(_SCENES)


@lru_cache(maxsize=16)
def make_scene(name: str) -> BenchScene:
    """Build a scene by its name."""
    if name not in _SCENES:
        raise TactuneError(f"there is no scene {name!r}; known are {', '.join(_SCENES)}")
    return replace(_SCENES[name](), name=name)


def _simulated(scene: str, depth_m: float) -> BenchScene:
    """Return the first frame of a simulated press that is at least ``depth_m`` deep, or the deepest."""
    from ..sources.simulator.source import SimulatorSource

    source = SimulatorSource(scene=scene, sensor="datasheet")
    depths = np.array([source.facts(index).depth_m for index in range(source.length)])
    index = int(np.argmax(depths >= min(depth_m, depths.max())))
    return BenchScene(scene, source.rig, load_preset("simulator").with_values(_TEST), source.read(index))


def synthetic_scene(
    points: int, width: int = 640, height: int = 480, noise_m: float = 0.001, seed: int = 0
) -> BenchScene:
    """Return a curved surface with about ``points`` proximity pixels of contact around the image centre.

    In contact both cameras see the same paraboloid. Elsewhere the proximity camera sees a surface 25 mm behind the
    membrane. The rig is that of the simulator, scaled to the image size. The tactile noise is a third of ``noise_m``.
    """
    rig = _scaled_rig(width, height)
    random = np.random.default_rng(seed)
    camera = rig.proximity.intrinsics
    origin = np.eye(4)
    membrane = _depth_of_paraboloid(camera, origin)
    v, u = np.mgrid[:height, :width]
    radius_px = np.sqrt(points / np.pi)
    contact = np.hypot(u - camera.cx, v - camera.cy) <= radius_px
    if points >= width * height:
        contact[:] = True
    seen = np.where(contact, membrane, membrane + 0.025) + random.normal(0, noise_m, membrane.shape)
    tactile = _depth_of_paraboloid(rig.tactile.intrinsics, np.asarray(rig.T_proximity_tactile))
    tactile = tactile + random.normal(0, noise_m / 3, tactile.shape)
    color = np.where(contact[..., None], _CONTACT_RGB, _MEMBRANE_RGB).astype(np.uint8)
    frame = SensorFrame(
        sequence=0,
        proximity_depth=_counts(seen, rig.proximity.depth_unit_m),
        tactile_depth=_counts(tactile, rig.tactile.depth_unit_m),
        proximity_color=color,
        truth=GroundTruth(contact=contact, depth_m=membrane.astype(np.float32)),
    )
    preset = load_preset("simulator").with_values(
        {
            **_TEST,
            "rig": None,
            "tolerance.t": 0.03,
            "mask.enabled": True,
            "mask.hue": (100, 125),
            "mask.saturation": (120, 255),
        }
    )
    return BenchScene(f"{points} points", rig, preset, frame)


def _scaled_rig(width: int, height: int) -> Rig:
    from ..sources.simulator.scene import simulator_rig

    rig = simulator_rig()

    def scaled(camera: DepthCamera) -> DepthCamera:
        return camera.model_copy(update={"intrinsics": _scaled(camera.intrinsics, width, height)})

    return Rig(
        proximity=scaled(rig.proximity),
        tactile=scaled(rig.tactile),
        proximity_color=None,
        T_proximity_tactile=rig.T_proximity_tactile,
    )


def _scaled(camera: Intrinsics, width: int, height: int) -> Intrinsics:
    """Return the same field of view in another image size."""
    across, down = width / camera.width, height / camera.height
    return camera.model_copy(
        update={
            "width": width, "height": height, "fx": camera.fx * across, "fy": camera.fy * down,
            "cx": (camera.cx + 0.5) * across - 0.5, "cy": (camera.cy + 0.5) * down - 0.5,
        }
    )  # fmt: skip


def _depth_of_paraboloid(camera: Intrinsics, T_p_camera: Float64Array) -> Float64Array:
    """Return the depth at which each pixel of a camera sees z = 0.25 + 0.6 (x^2 + y^2), metres."""
    rays = np.concatenate([camera.rays().astype(np.float64), np.ones((*camera.shape, 1))], axis=2)
    directions, start = rays @ T_p_camera[:3, :3].T, T_p_camera[:3, 3]
    depth = np.full(camera.shape, 0.25)
    for _ in range(60):
        points = start + directions * depth[..., None]
        miss = 0.25 + 0.6 * (points[..., 0] ** 2 + points[..., 1] ** 2) - points[..., 2]
        slope = directions[..., 2] - 1.2 * (points[..., 0] * directions[..., 0] + points[..., 1] * directions[..., 1])
        depth = depth + np.where(slope > 0.2, miss / slope, 0.0)
    return depth


def _counts(depth_m: Float64Array, unit_m: float) -> Uint16Array:
    return np.clip(np.rint(depth_m / unit_m), 1, 65534).astype(np.uint16)


_SCENES: dict[str, Callable[[], BenchScene]] = {
    "empty": lambda: synthetic_scene(0),  # nothing within 25 mm of the membrane
    "untouched": lambda: _simulated("cup", -math.inf),  # before the first touch, with reflecting prints
    "light-touch": lambda: _simulated("cup", LIGHT_M),
    "cup-medium": lambda: _simulated("cup", MEDIUM_M),
    "octopus-high": lambda: _simulated("octopus", math.inf),
    "noisy-51k": lambda: synthetic_scene(51_000, noise_m=0.002),
    "full-contact": lambda: synthetic_scene(640 * 480),
}
