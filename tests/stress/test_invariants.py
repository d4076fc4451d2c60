"""Properties of the pipeline that hold for every scene."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from random_cases import random_case
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.lab.bench import BenchScene, synthetic_scene
from tactune.core.model.frames import DepthCamera, Rig, SensorFrame, rigid_transform
from tactune.core.model.intrinsics import Intrinsics
from tactune.core.preset import Preset

PRESET = Preset(contact_test="tolerance")

SEEDS = st.integers(0, 2**32 - 1)


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS, first=st.floats(0, 0.3), second=st.floats(0, 0.3))
def test_the_patch_grows_with_t(seed: int, first: float, second: float) -> None:
    preset, rig, frame = random_case(np.random.default_rng(seed), adversarial=False)
    small, large = sorted((first, second))
    masks = [ContactPipeline(preset.with_value("tolerance.t", t), rig).process(frame).mask for t in (small, large)]
    assert not (masks[0] & ~masks[1]).any()


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS, power=st.integers(-2, 2))
def test_scaling_all_distances_scales_the_cloud(seed: int, power: int) -> None:
    """By powers of two, which are exact in float32."""
    preset, rig, frame = random_case(np.random.default_rng(seed), adversarial=False)
    preset = preset.with_values({"alignment.depth_offset_m": 0.0, "range.enabled": False, "mask.enabled": False})
    preset = preset.with_values(
        {"outliers.enabled": True, "outliers.k": 8, "alignment.homography.plane_distance_m": 0.3}
    )
    scale = 2.0**power
    pose = np.array(rig.T_proximity_tactile)
    pose[:3, 3] *= scale

    def scaled(camera: DepthCamera) -> DepthCamera:
        return camera.model_copy(update={"depth_unit_m": camera.depth_unit_m * scale})

    larger = Rig(
        proximity=scaled(rig.proximity),
        tactile=scaled(rig.tactile),
        T_proximity_tactile=rigid_transform(pose),
        proximity_color=rig.proximity_color,
    )
    plane = preset.with_value("alignment.homography.plane_distance_m", 0.3 * scale)
    before = ContactPipeline(preset, rig).process(frame)
    after = ContactPipeline(plane, larger).process(frame)
    assert np.array_equal(before.mask, after.mask)
    assert np.array_equal(before.points * np.float32(scale), after.points)


def _turned(camera: DepthCamera, turn: str) -> DepthCamera:
    """Return the camera whose image is the turned image."""
    lens = camera.intrinsics
    if turn == "left-right":
        update = {"cx": lens.width - 1 - lens.cx}
    elif turn == "up-down":
        update = {"cy": lens.height - 1 - lens.cy}
    else:  # a quarter turn: column becomes row
        update = {
            "width": lens.height, "height": lens.width, "fx": lens.fy, "fy": lens.fx,
            "cx": lens.cy, "cy": lens.width - 1 - lens.cx,
        }  # fmt: skip
    return camera.model_copy(update={"intrinsics": lens.model_copy(update=update)})


_FRAME_TURNS = {
    "left-right": (np.diag([-1.0, 1.0, 1.0, 1.0]), lambda image: image[:, ::-1]),
    "up-down": (np.diag([1.0, -1.0, 1.0, 1.0]), lambda image: image[::-1]),
    # numpy.rot90: a pixel (u, v) goes to (v, W - 1 - u), so x becomes -y and y becomes x
    "quarter": (np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]), np.rot90),
}


@pytest.mark.parametrize("turn", list(_FRAME_TURNS))
@pytest.mark.parametrize("model", ["rigid", "homography"])
def test_flips_and_quarter_turns_commute(turn: str, model: str) -> None:
    """Intrinsics, pose and depth unit are dyadic and no point projects to a pixel border, so masks must be equal."""
    lens = Intrinsics(width=64, height=32, fx=64.0, fy=64.0, cx=31.5, cy=15.5)
    T_p_t = np.eye(4)
    T_p_t[:3, 3] = (1 / 64, 1 / 128, 0.0)
    rig = Rig(
        proximity=DepthCamera(intrinsics=lens, depth_unit_m=2.0**-12),
        tactile=DepthCamera(intrinsics=lens, depth_unit_m=2.0**-12),
        T_proximity_tactile=rigid_transform(T_p_t),
    )
    random = np.random.default_rng(4)
    depth = random.integers(1000, 1060, (2, 32, 64)).astype(np.uint16)
    color = random.integers(0, 256, (32, 64, 3), dtype=np.uint8)
    frame = SensorFrame(0, depth[0], depth[1], color)
    matrix, turned = _FRAME_TURNS[turn]
    turned_rig = Rig(
        proximity=_turned(rig.proximity, turn),
        tactile=_turned(rig.tactile, turn),
        T_proximity_tactile=rigid_transform(matrix @ T_p_t @ np.linalg.inv(matrix)),
    )
    turned_frame = SensorFrame(0, *(np.ascontiguousarray(turned(image)) for image in (depth[0], depth[1], color)))
    preset = PRESET.with_values(
        {"alignment.model": model, "alignment.homography.plane_distance_m": 0.25, "tolerance.t": 0.011,
         "mask.enabled": True, "mask.hue": (20, 100), "outliers.k": 6, "outliers.ratio": 1.0}
    )  # fmt: skip
    before = ContactPipeline(preset, rig).process(frame)
    after = ContactPipeline(preset, turned_rig).process(turned_frame)
    assert before.mask.any()
    assert np.array_equal(turned(before.mask), after.mask)


def test_pipelines_in_many_threads_give_the_same_bits() -> None:
    scenes = [synthetic_scene(points, 160, 120, seed=points) for points in (300, 2000, 6000, 19_000)]
    alone = [_bits(scene) for scene in scenes]
    with ThreadPoolExecutor(4) as pool:
        for _ in range(5):
            assert list(pool.map(_bits, scenes)) == alone


def _bits(scene: BenchScene) -> bytes:
    pipeline = ContactPipeline(scene.preset, scene.rig)
    patch = pipeline.process(scene.frame)
    again = pipeline.process(replace(scene.frame))
    assert patch.points.tobytes() == again.points.tobytes()
    return patch.points.tobytes() + patch.provenance.tobytes()
