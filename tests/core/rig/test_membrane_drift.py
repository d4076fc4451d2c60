"""Drift since the untouched frame: pressure, camera pose, contact, or none."""

import numpy as np
import pytest

from rigs import one_place_rig
from tactune.core.model.frames import SensorFrame
from tactune.core.preset import Preset
from tactune.core.rig.drift import LIMIT_M, compare_with_untouched

WIDTH, HEIGHT = 160, 120
RIM_M, BULGE_M = 0.25, 0.06
RIG = one_place_rig(WIDTH, HEIGHT, 115.0)
LENS = RIG.tactile.intrinsics
V, U = np.mgrid[:HEIGHT, :WIDTH]
X, Y = (U - LENS.cx) / LENS.fx, (V - LENS.cy) / LENS.fy
RADIUS = np.hypot(U - LENS.cx, V - LENS.cy) / 55
#: Prints on which the proximity camera sees the membrane, three of them off the middle.
PRINTS = sum(np.hypot(U - u, V - v) < 9 for u, v in ((50, 40), (110, 50), (80, 90))) > 0


def membrane(bulge_m=BULGE_M):
    return RIM_M + bulge_m * (1 - RADIUS**2)


def seen(tactile_m, proximity_m=None, seed=1):
    """A frame with noise; off the prints the proximity camera sees the room, which may be another each time."""
    rng = np.random.default_rng(seed)
    tactile = np.where(RADIUS < 1, tactile_m + rng.normal(0, 0.0006, tactile_m.shape), 0.0)
    on_prints = tactile_m if proximity_m is None else proximity_m
    proximity = np.where(PRINTS, on_prints + rng.normal(0, 0.001, tactile_m.shape), 0.6 + 0.1 * rng.random())
    return SensorFrame(
        sequence=seed,
        tactile_depth=np.rint(tactile / 0.0001).astype(np.uint16),
        proximity_depth=np.rint(proximity / 0.00025).astype(np.uint16),
        proximity_color=np.zeros((HEIGHT, WIDTH, 3), np.uint8),
    )


UNTOUCHED = seen(membrane(), seed=0)


@pytest.mark.parametrize("more_m", [0.004, -0.003])
def test_another_pressure_is_told_from_a_camera_that_moved(more_m):
    drift = compare_with_untouched(Preset(), RIG, seen(membrane(BULGE_M + more_m)), UNTOUCHED)
    assert drift.verdict == "inflation"
    assert drift.inflation_m == pytest.approx(more_m, rel=0.1)
    assert f"{1e3 * abs(drift.inflation_m):.1f} mm farther {'out' if more_m > 0 else 'in'}" in drift.sentence
    assert drift.moved_m["tactile"] < LIMIT_M / 2


@pytest.mark.parametrize(
    ("tactile", "proximity", "said"),
    [
        (0.003, 0.0, "The tactile camera has moved"),
        (0.010 * X, 0.0, "The tactile camera has moved"),
        (0.0, -0.004, "The proximity camera has moved"),
        (0.002, 0.002, "Both cameras have moved"),
    ],
)
def test_an_offset_up_to_the_rim_is_a_camera(tactile, proximity, said):
    now = membrane()
    drift = compare_with_untouched(Preset(), RIG, seen(now + tactile, now + proximity), UNTOUCHED)
    assert drift.verdict == "camera"
    assert drift.sentence.startswith(said)
    assert abs(drift.inflation_m) < LIMIT_M / 2


def test_a_dent_is_a_touch_and_no_drift():
    dent = 0.012 * np.exp(-((U - 60) ** 2 + (V - 50) ** 2) / (2 * 10**2))
    drift = compare_with_untouched(Preset(), RIG, seen(membrane() - dent, membrane()), UNTOUCHED)
    assert drift.verdict == "touched"
    assert "remove it" in drift.sentence
