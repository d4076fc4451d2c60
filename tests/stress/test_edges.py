"""Extreme inputs give the reference's result or a clear error, never nan."""

from dataclasses import replace

import numpy as np
import pytest

from reference_patches import reference_patch
from rigs import one_place_rig
from tactune.core.contact.outliers.grid import Grid
from tactune.core.contact.outliers.statistical import statistical_inliers
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.errors import TactuneError
from tactune.core.lab.bench import synthetic_scene
from tactune.core.model.frames import ColorCamera, SensorFrame, rigid_transform
from tactune.core.model.intrinsics import Distortion
from tactune.core.preset import Preset

PRESET = Preset(contact_test="tolerance")


def small_rig(width=64, height=48, **tactile):
    rig = one_place_rig(width, height, 60.0)
    lens = rig.tactile.intrinsics.model_copy(update=tactile)
    return rig.model_copy(update={"tactile": rig.tactile.model_copy(update={"intrinsics": lens})})


def frame_of(rig, proximity, tactile):
    height, width = rig.proximity.intrinsics.shape
    return SensorFrame(
        sequence=0,
        proximity_depth=np.broadcast_to(np.asarray(proximity, np.uint16), (height, width)).copy(),
        tactile_depth=np.broadcast_to(np.asarray(tactile, np.uint16), (height, width)).copy(),
        proximity_color=np.full((height, width, 3), 128, np.uint8),
    )


def assert_as_the_reference(preset, rig, frame):
    patch = ContactPipeline(preset, rig).process(frame)
    expected = reference_patch(preset, rig, frame)
    assert np.array_equal(patch.provenance, expected.provenance)
    assert np.isfinite(patch.points).all()
    assert np.array_equal(patch.points, expected.points)
    return patch


def homography(matrix):
    values = {"alignment.model": "homography", "alignment.homography.H_p_t": np.asarray(matrix).tolist()}
    return values | {"outliers.enabled": False}


@pytest.mark.parametrize(
    ("matrix", "count"),
    [
        ([[1, 0, 0], [0, 0.1, 0], [0, 0, 1]], 64 * 5),
        ([[-1, 0, 63], [0, 1, 0], [0, 0, 1]], 64 * 48),
        ([[1, 0, 1e6], [0, 1, 0], [0, 0, 1]], 0),
        ([[1, 0, 0], [0, 1, 0], [1 / 32, 0, -0.5]], 963),
        ([[1, 0, 0], [0, 1, 0], [0, 0, -1]], 1),
        ([[1, 1, 0], [1, 1 + 1e-9, 0], [0, 0, 1]], 48),
    ],
)
def test_odd_homographies(matrix, count):
    rig = small_rig()
    patch = assert_as_the_reference(PRESET.with_values(homography(matrix)), rig, frame_of(rig, 1200, 3000))
    assert len(patch.points) == count


@pytest.mark.parametrize("scale", [0.0, float("nan"), 1e-16])
def test_homographies_that_are_none_are_refused(scale):
    with pytest.raises(TactuneError, match="H_p_t"):
        PRESET.with_values(homography(np.diag([1.0, scale, 1.0])))


@pytest.mark.parametrize("depth", [0, 1, 65534, 65535])
@pytest.mark.parametrize("other", [0, 1, 65535])
@pytest.mark.parametrize("model", ["rigid", "homography"])
def test_depths_at_the_ends_of_the_scale(depth, other, model):
    rig = small_rig()
    patch = assert_as_the_reference(
        PRESET.with_values({"alignment.model": model, "outliers.enabled": False, "tolerance.t": 1.0}),
        rig,
        frame_of(rig, depth, other),
    )
    if depth in {0, 65535} or other in {0, 65535}:
        assert len(patch.points) == 0


@pytest.mark.parametrize(
    "pose",
    [
        ((0.0, 0.0, 0.5), 0.0),  # every point behind the tactile camera
        ((0.0, 0.0, 0.3), 0.0),  # the camera stands in the surface
        ((0.3, 0.0, 0.3), 1.5),  # it looks along the surface
        ((0.0, 0.0, 0.0), np.pi),  # it looks away
        ((0.99, 0.0, 0.0), 0.0),
    ],
)
@pytest.mark.parametrize("distorted", [False, True])
def test_odd_poses(pose, distorted):
    translation, angle = pose
    matrix = np.eye(4)
    matrix[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    matrix[:3, 3] = translation
    lens = {"distortion": Distortion.BROWN_CONRADY, "coefficients": (4.0, -9.0, 0.3, 0.3, 30.0)} if distorted else {}
    rig = small_rig(**lens)
    values = {"alignment.rigid.T_proximity_tactile": matrix.tolist(), "tolerance.t": 1.0, "outliers.enabled": False}
    patch = assert_as_the_reference(PRESET.with_values(values), rig, frame_of(rig, 1200, 3000))
    assert len(patch.points) == 0


@pytest.mark.parametrize("size", [(1, 1), (1, 37), (41, 1), (33, 7), (320, 180)])
@pytest.mark.parametrize("model", ["rigid", "homography"])
def test_image_sizes(size, model):
    rig = small_rig(*size)
    values = {"alignment.model": model, "outliers.k": 3, "outliers.enabled": size != (320, 180)}
    patch = assert_as_the_reference(PRESET.with_values(values), rig, frame_of(rig, 1200, 3000))
    assert patch.mask.shape == size[::-1]


def test_arrays_of_any_layout_give_the_same_bits():
    scene = synthetic_scene(600)
    expected = ContactPipeline(scene.preset, scene.rig).process(scene.frame)
    frame = scene.frame
    wide = np.zeros((480, 1280), np.uint16)
    wide[:, ::2] = frame.proximity_depth
    fortran = np.asfortranarray(frame.tactile_depth)
    read_only = frame.proximity_color.copy()
    read_only.flags.writeable = False
    odd = replace(frame, proximity_depth=wide[:, ::2], tactile_depth=fortran, proximity_color=read_only)
    patch = ContactPipeline(scene.preset, scene.rig).process(odd)
    assert patch.points.tobytes() == expected.points.tobytes()
    with pytest.raises(TactuneError, match="proximity_depth"):
        replace(frame, proximity_depth=frame.proximity_depth.astype(">u2"))


@pytest.mark.parametrize("count", [1, 2, 20, 21])
@pytest.mark.parametrize("k", [1, 20, 1000])
@pytest.mark.parametrize("spread", ["plane", "identical depth", "far and near"])
def test_few_points_and_any_k(count, k, spread):
    rig = small_rig()
    frame = frame_of(rig, 0, 3000)
    proximity = frame.proximity_depth.copy()
    flat = proximity.reshape(-1)
    places = np.linspace(0, flat.size - 1, count).astype(int)
    flat[places] = 1200 if spread != "far and near" else np.where(np.arange(count) % 2, 1190, 1210)
    preset = PRESET.with_values({"outliers.k": k, "outliers.ratio": 1e-9 if spread == "plane" else 2.0})
    patch = assert_as_the_reference(preset, rig, replace(frame, proximity_depth=proximity))
    assert len(patch.points) <= count


def test_points_in_one_place_have_no_inliers():
    lens = small_rig().proximity.intrinsics
    points = np.zeros((30, 3), np.float32)
    points[:, 2] = np.float32(1e-40)  # a denormal depth
    found = statistical_inliers(points, np.arange(30), Grid(lens), 5, 2.0)
    assert found.shape == (30,)
    assert not found.any()


def test_a_colour_camera_that_sees_nothing():
    rig = small_rig()
    away = np.diag([-1.0, 1.0, -1.0, 1.0])
    looking_away = ColorCamera(intrinsics=rig.proximity.intrinsics, T_color_depth=rigid_transform(away))
    rig = rig.model_copy(update={"proximity_color": looking_away})
    patch = assert_as_the_reference(
        PRESET.with_values({"mask.enabled": True, "outliers.enabled": False}), rig, frame_of(rig, 1200, 3000)
    )
    assert len(patch.points) == 64 * 48
