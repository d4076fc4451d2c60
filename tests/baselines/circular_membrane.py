"""A circular membrane whose shapes are known in closed form, and what a tactile camera sees of it.

A flat membrane of radius a under the tension T, clamped at r = a, bulges under a pressure p with small
slopes by ``w = p (a^2 - r^2) / (4 T)``. A flat plate that presses it down to the height h touches it up to
a radius c, where it leaves the plate without a kink: with ``T laplace(w) = -p`` outside, ``w'(c) = 0`` and
``w(a) = 0``,

    w(r) = p / (4 T) (a^2 - r^2 + 2 c^2 ln(r / a)),     h = w(c),

and the plate carries the pressure p everywhere within c. The air's pressure follows from the volume.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tactune.core.baselines.membrane_problem import ATMOSPHERE_PA
from tactune.core.frames import DepthCamera, Rig, SensorFrame
from tactune.core.intrinsics import Intrinsics

RIM_M = 0.25


def rig_for_membranes() -> Rig:
    """Return two cameras side by side without lens distortion, with fine depth counts."""
    camera = Intrinsics(width=320, height=240, fx=260.0, fy=260.0, cx=159.5, cy=119.5)
    pose = np.eye(4)
    pose[0, 3] = 0.02
    return Rig(
        proximity=DepthCamera(intrinsics=camera, depth_unit_m=1e-5),
        tactile=DepthCamera(intrinsics=camera, depth_unit_m=1e-5),
        T_proximity_tactile=tuple(map(tuple, pose.tolist())),
    )


@dataclass(frozen=True)
class CircularMembrane:
    radius_m: float = 0.095
    apex_m: float = 0.005
    gauge_pressure_pa: float = 1600.0
    housing_m3: float = 0.002

    @property
    def per_pressure_m(self) -> float:
        """p0 / (4 T), so that the untouched apex is at ``apex_m``."""
        return self.apex_m / self.radius_m**2

    def shape(self, r, contact_radius_m: float):
        """Height over the rim's plane per p / p0, metres."""
        a, c = self.radius_m, contact_radius_m
        r = np.clip(np.asarray(r, float), max(c, 1e-9), a)
        return self.per_pressure_m * (a**2 - r**2 + 2 * c**2 * np.log(r / a))

    def volume(self, contact_radius_m: float) -> float:
        """Volume over the rim's plane per p / p0, by fine quadrature."""
        edges = np.linspace(0.0, self.radius_m, 20_001)
        r = (edges[1:] + edges[:-1]) / 2
        return float(np.sum(self.shape(r, contact_radius_m) * 2 * np.pi * r * np.diff(edges)))

    def pressure(self, contact_radius_m: float) -> float:
        """p / p0 from the gas law, linear in the volume."""
        untouched = self.volume(0.0)
        absolute = (ATMOSPHERE_PA + self.gauge_pressure_pa) / self.gauge_pressure_pa
        gas = absolute / (self.housing_m3 + untouched)
        return (1 + gas * untouched) / (1 + gas * self.volume(contact_radius_m))

    def depth_m(self, camera: Intrinsics, contact_radius_m: float):
        """Depth at which each pixel sees the membrane; nan outside of it."""
        rays = camera.rays().astype(np.float64)
        slope = np.hypot(rays[..., 0], rays[..., 1])
        pressure, depth = self.pressure(contact_radius_m), np.full(camera.shape, RIM_M)
        for _ in range(50):
            depth = RIM_M + pressure * self.shape(slope * depth, contact_radius_m)
        return np.where(slope * depth <= self.radius_m, depth, np.nan)

    def frame(self, rig: Rig, contact_radius_m: float, noise_m: float = 0.0, seed: int = 0) -> SensorFrame:
        depth = self.depth_m(rig.tactile.intrinsics, contact_radius_m)
        depth = depth + np.random.default_rng(seed).normal(0, noise_m, depth.shape)
        counts = np.nan_to_num(np.rint(depth / rig.tactile.depth_unit_m)).astype(np.uint16)
        color = np.zeros((*rig.proximity_color_shape, 3), np.uint8)
        return SensorFrame(0, np.zeros(rig.proximity.intrinsics.shape, np.uint16), counts, color)
