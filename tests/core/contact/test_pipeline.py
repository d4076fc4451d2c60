from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reference_patches import reference_patch, same_patch
from tactune.core.contact.alignment import homography_table, tactile_homography
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.errors import FrameError, RigMismatchError
from tactune.core.lab.bench import synthetic_scene
from tactune.core.model.frames import SensorFrame
from tactune.core.model.patch import Provenance
from tactune.core.preset import Preset

PRESET = Preset(contact_test="tolerance")

settings_of_all_kinds = st.fixed_dictionaries(
    {
        "alignment.model": st.sampled_from(["rigid", "homography"]),
        "alignment.depth_scale": st.floats(0.95, 1.05),
        "alignment.depth_offset_m": st.floats(-0.01, 0.01),
        "tolerance.t": st.sampled_from([0.0, 0.005, 0.02, 0.05, 1.0]),
        "mask.enabled": st.booleans(),
        "mask.hue": st.tuples(st.integers(0, 179), st.integers(0, 179)),
        "mask.saturation": st.sampled_from([(0, 255), (60, 255), (0, 120)]),
        "outliers.enabled": st.booleans(),
        "outliers.k": st.integers(2, 30),
        "outliers.ratio": st.floats(0.2, 3.0),
        "outliers.min_cluster_area_mm2": st.sampled_from([0.0, 100.0, 2000.0]),
        "range.enabled": st.booleans(),
        "range.limits_m": st.sampled_from([(0.1, 0.28), (0.26, 0.5)]),
        "region.enabled": st.booleans(),
        "region.rectangle": st.tuples(st.integers(0, 60), st.integers(0, 50), st.integers(1, 99), st.integers(1, 99)),
    }
)


@settings(max_examples=150, deadline=None)
@given(
    values=settings_of_all_kinds, seed=st.integers(0, 1000), color=st.booleans(),
    width=st.sampled_from([80, 80, 64, 73, 17, 9]),
    distortion=st.sampled_from(["none", "brown_conrady", "modified_brown_conrady", "inverse_brown_conrady"]),
)  # fmt: skip
def test_every_input_gives_the_references_bits(make_rig, make_frame, values, seed, color, width, distortion):
    rig = make_rig(width=width, color=color, distortion=distortion, bend=0.02)
    if values["region.rectangle"][0] >= width:
        values = values | {"region.enabled": False}
    preset = PRESET.with_values(values)
    frame = make_frame(rig, seed)
    patch = ContactPipeline(preset, rig).process(frame)
    assert same_patch(patch, reference_patch(preset, rig, frame))
    assert patch.points.dtype == np.float32
    assert patch.mask.sum() == len(patch.points)


def test_rigid_alignment_finds_a_surface_that_both_cameras_see(make_rig):
    """A plane rendered exactly for both cameras agrees everywhere that both see it."""
    rig = make_rig(width=160)
    normal, distance = np.array([0.1, -0.05, 1.0]), 0.3

    def render(camera, pose):
        v, u = np.mgrid[: camera.intrinsics.height, : camera.intrinsics.width]
        rays = np.c_[camera.intrinsics.normalise(np.c_[u.ravel(), v.ravel()]), np.ones(u.size)]
        plane = normal @ pose[:3, :3]
        depth = (distance - normal @ pose[:3, 3]) / (rays @ plane)
        return np.rint(depth / camera.depth_unit_m).astype(np.uint16).reshape(u.shape)

    frame = SensorFrame(
        0, render(rig.proximity, np.eye(4)), render(rig.tactile, np.asarray(rig.T_proximity_tactile)),
        np.zeros((*rig.proximity_color_shape, 3), np.uint8),
    )  # fmt: skip
    preset = PRESET.with_values({"tolerance.t": 0.003, "outliers.enabled": False})
    patch = ContactPipeline(preset, rig).process(frame)
    verdicts = set(np.unique(patch.provenance))
    assert verdicts == {Provenance.CONTACT, Provenance.NO_TACTILE_DEPTH}
    assert np.nanmax(np.abs(patch.relative_difference)) < 0.003


def test_the_induced_homography_is_exact_on_its_plane(make_rig):
    rig = make_rig()
    section = PRESET.with_value("alignment.homography.plane_distance_m", 0.25).alignment
    corners = np.array([[-0.05, -0.04, 0.25], [0.06, -0.03, 0.25], [0.04, 0.05, 0.25], [-0.03, 0.02, 0.25]])
    T_t_p = np.linalg.inv(np.asarray(rig.T_proximity_tactile))
    seen = rig.tactile.intrinsics.project(corners @ T_t_p[:3, :3].T + T_t_p[:3, 3])
    mapped = cv2.perspectiveTransform(seen.reshape(-1, 1, 2), tactile_homography(section, rig)).reshape(-1, 2)
    assert mapped == pytest.approx(rig.proximity.intrinsics.project(corners), abs=1e-9)


def test_the_homography_lookup_is_opencvs_nearest_warp():
    H = np.array([[1.02, 0.03, -4.3], [-0.02, 0.97, 2.6], [1e-4, -2e-4, 1.0]])
    image = np.arange(1, 60 * 80 + 1, dtype=np.float32).reshape(60, 80)
    table = homography_table(H, (50, 70), (60, 80))
    ours = np.where(table >= 0, image.ravel()[table], 0)
    v, u = np.mgrid[:50, :70].astype(np.float64)
    x, y, w = np.einsum("ij,jvu->ivu", np.linalg.inv(H), np.stack([u, v, np.ones_like(u)]))
    theirs = cv2.remap(image, np.rint(x / w).astype(np.float32), np.rint(y / w).astype(np.float32), cv2.INTER_NEAREST)
    assert (ours != theirs).mean() < 0.001  # pixels whose preimage lies half way between two
    assert (ours > 0).mean() > 0.8


def test_area_and_centroid_of_a_known_patch(make_rig):
    rig = make_rig(color=False)
    counts = np.zeros((60, 80), np.uint16)
    counts[20:30, 30:50] = 1200  # 0.3 m
    frame = SensorFrame(0, counts, np.full((60, 80), 3000, np.uint16), np.zeros((60, 80, 3), np.uint8))
    patch = ContactPipeline(PRESET.with_values({"tolerance.t": 0.05, "outliers.enabled": False}), rig).process(frame)
    camera = rig.proximity.intrinsics
    assert patch.mask.sum() == 200
    assert patch.area_mm2 == pytest.approx(200 * (300 / camera.fx) * (300 / camera.fy), rel=1e-5)
    expected = np.append(camera.normalise([[39.5, 24.5]])[0] * 0.3, 0.3)
    assert patch.centroid_m == pytest.approx(expected, rel=1e-5)


def test_a_preset_of_another_size_is_refused_and_of_another_serial_warned_of(make_rig):
    rig = make_rig()
    with pytest.raises(RigMismatchError, match=r"100 x 60.*80 x 60"):
        ContactPipeline(Preset(name="wide", rig=make_rig(width=100)), rig)
    other = rig.model_copy(update={"tactile": rig.tactile.model_copy(update={"serial": "T2"})})
    (warning,) = ContactPipeline(Preset(name="mine", rig=rig), other).warnings
    assert "T1" in warning
    assert "T2" in warning
    assert ContactPipeline(Preset(rig=rig), rig).warnings == []


def test_a_refused_update_leaves_the_old_preset_in_force(make_rig, make_frame):
    rig = make_rig()
    contact = ContactPipeline(PRESET, rig)
    before = contact.process(make_frame(rig))
    with pytest.raises(RigMismatchError):
        contact.update(Preset(rig=make_rig(width=100)))
    assert contact.preset == PRESET
    assert same_patch(contact.process(make_frame(rig)), before)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"proximity_depth": np.zeros((60, 80), np.float32)}, "proximity_depth must be uint16"),
        ({"proximity_color": np.zeros((60, 80, 4), np.uint8)}, r"uint8, \(H, W, 3\)"),
        ({"tactile_depth": np.zeros((59, 80), np.uint16)}, "80 x 59 pixels.*80 x 60"),
    ],
)
def test_frames_of_the_wrong_shape_are_refused(make_rig, change, words):
    rig = make_rig()
    arrays = {
        "proximity_depth": np.zeros((60, 80), np.uint16),
        "tactile_depth": np.zeros((60, 80), np.uint16),
        "proximity_color": np.zeros((60, 80, 3), np.uint8),
    }
    with pytest.raises(FrameError, match=words):
        ContactPipeline(PRESET, rig).process(SensorFrame(sequence=7, **(arrays | change)))


def test_pipelines_in_many_threads_give_the_same_bits():
    scenes = [synthetic_scene(points) for points in (300, 2000, 20_000, 60_000)]

    def bits(scene):
        patch = ContactPipeline(scene.preset, scene.rig).process(scene.frame)
        return patch.points.tobytes() + patch.provenance.tobytes()

    alone = list(map(bits, scenes))
    with ThreadPoolExecutor(4) as pool:
        for _ in range(3):
            assert list(pool.map(bits, scenes)) == alone


@pytest.mark.parametrize("test", ["membrane", "tolerance"])
def test_points_are_one_array_that_later_frames_do_not_overwrite(make_rig, make_frame, test):
    rig = make_rig(width=320, height=240, color=True)
    pipeline, frame = ContactPipeline(Preset(contact_test=test), rig), make_frame(rig)
    patch = pipeline.process(frame)
    points = patch.points
    assert points is patch.points
    assert points.flags.c_contiguous
    assert points.flags.owndata
    assert (points.dtype, points.shape) == (np.float32, (int(patch.mask.sum()), 3))
    assert len(points) > 1000
    before = points.copy()
    nearer = replace(frame, proximity_depth=frame.proximity_depth - 8, tactile_depth=frame.tactile_depth - 8)
    assert not np.array_equal(pipeline.process(nearer).points[:1000], before[:1000])
    assert np.array_equal(points, before)
