import numpy as np
import pytest

from tactune.core.calibration.geometry import mapped
from tactune.core.calibration.points import PointArrays
from tactune.core.sources.simulator.scene import simulator_rig


class Plane:
    """Clicks related by a known homography."""

    grid = np.stack(np.meshgrid(np.linspace(0, 639, 12), np.linspace(0, 479, 9)), axis=-1).reshape(-1, 2)
    mild = np.array([[1.15, 0.02, -30], [-0.015, 1.18, -20], [2e-5, -3e-5, 1]])
    strong = np.array([[1.15, 0.02, -30], [-0.015, 1.18, -20], [5e-4, -3e-4, 1]])

    @staticmethod
    def points(tactile, proximity):
        """Points without depth."""
        unknown = np.full(len(tactile), np.nan)
        return PointArrays(tactile, unknown, proximity, np.zeros(len(tactile), bool))

    def clicks(self, seed, count, H=mild, sigma=0.7, wrong=0.0):
        rng = np.random.default_rng(seed)
        tactile = rng.uniform((20, 20), (620, 460), (count, 2))
        proximity = mapped(H, tactile) + sigma * rng.standard_normal((count, 2))
        tactile = tactile + sigma * rng.standard_normal((count, 2))
        chosen = rng.choice(count, round(wrong * count), replace=False)
        proximity[chosen] = rng.uniform((0, 0), (639, 479), (len(chosen), 2))
        return self.points(tactile, proximity)

    def right(self, points, H=mild):
        """Pairs that noise alone could have moved."""
        return np.hypot(*(mapped(H, points.tactile) - points.proximity).T) < 8.0

    def error(self, fit, H=mild):
        return np.hypot(*(mapped(fit.alignment.homography, self.grid) - mapped(H, self.grid)).T)


@pytest.fixture(scope="session")
def plane():
    return Plane()


@pytest.fixture(scope="session")
def rig():
    return simulator_rig()
