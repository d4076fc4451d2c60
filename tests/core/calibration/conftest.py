from __future__ import annotations

import numpy as np
import pytest

from tactune.core.model.frames import Rig
from tactune.core.sources.simulator.scene import simulator_rig

GRID = np.stack(np.meshgrid(np.linspace(0, 639, 12), np.linspace(0, 479, 9)), axis=-1).reshape(-1, 2)
MILD = np.array([[1.15, 0.02, -30], [-0.015, 1.18, -20], [2e-5, -3e-5, 1]])
STRONG = np.array([[1.15, 0.02, -30], [-0.015, 1.18, -20], [5e-4, -3e-4, 1]])


def transfer(H, points):
    mapped = np.column_stack([points, np.ones(len(points))]) @ H.T
    return mapped[:, :2] / mapped[:, 2:]


class Plane:
    """Clicks related by a known homography."""

    grid = GRID
    mild = MILD
    strong = STRONG
    transfer = staticmethod(transfer)

    @staticmethod
    def clicks(seed, count, H=MILD, sigma=0.7, wrong=0.0):
        rng = np.random.default_rng(seed)
        tactile = rng.uniform((20, 20), (620, 460), (count, 2))
        proximity = transfer(H, tactile) + sigma * rng.standard_normal((count, 2))
        tactile = tactile + sigma * rng.standard_normal((count, 2))
        chosen = rng.choice(count, round(wrong * count), replace=False)
        proximity[chosen] = rng.uniform((0, 0), (639, 479), (len(chosen), 2))
        return tactile, proximity

    @staticmethod
    def right(tactile, proximity, H=MILD):
        """Pairs that noise alone could have moved."""
        return np.hypot(*(transfer(H, tactile) - proximity).T) < 8.0

    @staticmethod
    def error(fit, H=MILD, places=GRID):
        return np.hypot(*(fit.predict(places) - transfer(H, places)).T)


@pytest.fixture(scope="session")
def plane() -> Plane:
    return Plane()


@pytest.fixture(scope="session")
def rig() -> Rig:
    return simulator_rig()
