"""A circular membrane with closed-form shapes, and its images in two cameras.

A flat membrane of radius a under the tension T, clamped at r = a, is pressed by a flat plate that touches it up to a
radius c. With ``T laplace(w) = -p`` outside, ``w'(c) = 0`` and ``w(a) = 0``,

    w(r) = p / (4 T) (a^2 - r^2 + 2 c^2 ln(r / a)),     h = w(c),

and the plate carries the pressure p everywhere within c. The air's pressure follows from the volume.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from tactune.core.lab.mechanics import ATMOSPHERE_PA
from tactune.core.model.frames import DepthCamera, GroundTruth, Rig, SensorFrame
from tactune.core.model.intrinsics import Intrinsics

RIM_M = 0.25
#: The tactile camera stands so far to the right of the proximity camera.
BASELINE_M = 0.02
BACKDROP_M = 0.5


@dataclass(frozen=True)
class CircularMembrane:
    """The membrane in front of both cameras, its centre ``aside_m`` to the right of the tactile camera's axis."""

    rig: Rig
    radius_m: float = 0.095
    apex_m: float = 0.005
    gauge_pressure_pa: float = 1600.0
    housing_m3: float = 0.002
    rim_m: float = RIM_M
    aside_m: float = 0.0

    def shape(self, r, contact_radius_m):
        """Height over the rim's plane per p / p0, metres; p0 / (4 T) is such that the apex is at ``apex_m``."""
        a, c = self.radius_m, contact_radius_m
        r = np.clip(np.asarray(r, float), max(c, 1e-9), a)
        return self.apex_m / a**2 * (a**2 - r**2 + 2 * c**2 * np.log(r / a))

    def volume(self, contact_radius_m):
        """Volume over the rim's plane per p / p0, by fine quadrature."""
        edges = np.linspace(0.0, self.radius_m, 20_001)
        r = (edges[1:] + edges[:-1]) / 2
        return float(np.sum(self.shape(r, contact_radius_m) * 2 * np.pi * r * np.diff(edges)))

    def pressure(self, contact_radius_m):
        """p / p0 by the gas law, linear in the volume."""
        untouched = self.volume(0.0)
        absolute = (ATMOSPHERE_PA + self.gauge_pressure_pa) / self.gauge_pressure_pa
        gas = absolute / (self.housing_m3 + untouched)
        return (1 + gas * untouched) / (1 + gas * self.volume(contact_radius_m))

    def height(self, r, contact_radius_m):
        """Height over the rim's plane, metres; the plate's own within its edge."""
        return self.pressure(contact_radius_m) * self.shape(r, contact_radius_m)

    def depth_m(self, camera, middle_x_m, contact_radius_m):
        """Return depth and distance from the membrane's centre for each pixel, metres; nan outside the membrane."""
        x, y = np.moveaxis(camera.rays().astype(np.float64), 2, 0)
        depth = np.full(camera.shape, self.rim_m)
        for _ in range(50):
            r = np.hypot(x * depth - middle_x_m, y * depth)
            depth = self.rim_m + self.height(r, contact_radius_m)
        return np.where(r <= self.radius_m, depth, np.nan), r

    def frame(self, contact_radius_m, noise_m=0.0, seed=0, gap_m=0.0):
        """What is seen with a plate of radius c pressing; none for c = 0.

        With a gap the plate hovers that far above the untouched apex, and is as large as c.
        """
        touching = 0.0 if gap_m > 0 else contact_radius_m
        tactile, _ = self.depth_m(self.rig.tactile.intrinsics, self.aside_m, touching)
        tactile = tactile + np.random.default_rng(seed).normal(0, noise_m, tactile.shape)
        membrane, r = self.depth_m(self.rig.proximity.intrinsics, BASELINE_M + self.aside_m, touching)
        plate_m = self.rim_m + (self.apex_m + gap_m if gap_m > 0 else self.height(contact_radius_m, contact_radius_m))
        x, y = np.moveaxis(self.rig.proximity.intrinsics.rays().astype(np.float64), 2, 0)
        on_plate = np.hypot(x * plate_m - BASELINE_M - self.aside_m, y * plate_m) < contact_radius_m
        color = np.zeros((*self.rig.proximity_color_shape, 3), np.uint8)
        return SensorFrame(
            sequence=seed,
            proximity_depth=_counts(np.where(on_plate, plate_m, BACKDROP_M), self.rig.proximity.depth_unit_m),
            tactile_depth=_counts(tactile, self.rig.tactile.depth_unit_m),
            proximity_color=color,
            truth=GroundTruth(contact=(r < touching), depth_m=membrane.astype(np.float32)),
        )


def _counts(depth_m, unit_m):
    return np.nan_to_num(np.rint(depth_m / unit_m)).astype(np.uint16)


@pytest.fixture(scope="session")
def small_rig():
    """Two cameras side by side without lens distortion, with fine depth counts."""
    camera = Intrinsics(width=320, height=240, fx=260.0, fy=260.0, cx=159.5, cy=119.5)
    pose = np.eye(4)
    pose[0, 3] = BASELINE_M
    return Rig(
        proximity=DepthCamera(intrinsics=camera, depth_unit_m=1e-5),
        tactile=DepthCamera(intrinsics=camera, depth_unit_m=1e-5),
        T_proximity_tactile=pose.tolist(),
    )


@pytest.fixture(scope="session")
def shallow(small_rig):
    """Slopes up to 0.1, for which the closed forms hold to a hundredth."""
    return CircularMembrane(small_rig)


@pytest.fixture(scope="session")
def bulged(small_rig):
    return CircularMembrane(small_rig, apex_m=0.020)


@pytest.fixture(scope="session")
def cup_frames():
    """The rig, the untouched membrane, and a cup pressed 24 mm deep."""
    from tactune.core.sources.simulator.simulator_source import SimulatorSource

    source = SimulatorSource(scene="cup", sensor="datasheet")
    depths = np.array([source.facts(index).depth_m for index in range(source.length)])
    return source.rig, source.read(0), source.read(int(np.argmax(depths >= 0.024)))
