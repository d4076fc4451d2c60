"""The benchmark: exact engines agree, slower engines take longer, shortfalls are found."""

from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

from reference_patches import reference_patch
from tactune.core.lab import bench
from tactune.core.lab.bench import ENGINES, Check, compare_engines, synthetic_scene

# Importing it takes 2 s in every test process that collects this file.
pytestmark = [
    pytest.mark.skipif(find_spec("open3d") is None, reason="needs the extra lab"),
    pytest.mark.filterwarnings("ignore:Open3D was built with CUDA:ImportWarning"),
]


@pytest.fixture(scope="module")
def scene():
    return synthetic_scene(3000)


def test_baseline_and_pipeline_agree_with_the_float64_reference(scene):
    expected = reference_patch(scene.preset, scene.rig, scene.frame, np.float64).pixels
    assert len(expected) > 1000
    for name in ("numpy", "tactune"):
        points, pixels = ENGINES[name](scene)()
        np.testing.assert_array_equal(pixels(), expected)
        assert len(points) == len(expected)
    near, pixels = ENGINES["open3d"](scene)()
    assert len(np.intersect1d(pixels(), expected)) > 0.9 * len(expected) and len(near) > 1000


def test_a_check_that_falls_short_says_so_and_the_gate_finds_a_slow_pipeline(monkeypatch):
    assert str(Check("speed", 5.9, 6)).startswith("SHORT speed: 5.90 (must be >= 6)")
    assert Check("speed", 6.0, 6).holds
    assert not Check("pixels", 1, 0, at_least=False).holds

    def slowed(*args, **options):
        return [replace(row, ratio=1.0) for row in compare_engines(*args, **options)]

    monkeypatch.setattr(bench, "compare_engines", slowed)
    assert [check.holds for check in bench.whole_pipeline(3, ["empty"])] == [False, True]
