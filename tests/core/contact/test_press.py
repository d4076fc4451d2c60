"""Pressed regions of the membrane, detected by their curvature."""

from __future__ import annotations

import numpy as np
import pytest

from rigs import one_place_rig
from tactune.core.contact.alignment import make_alignment
from tactune.core.contact.kernels.chain import Region
from tactune.core.contact.membrane.press import bulge_per_m, with_light_contact
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.model.frames import DepthCamera, Rig, SensorFrame
from tactune.core.model.intrinsics import Intrinsics
from tactune.core.model.provenance import Provenance
from tactune.core.preset import Preset

WIDTH, HEIGHT, UNIT_M = 320, 240, 1e-5
BEHIND_M = 0.6  # in these units uint16 ends at 0.655 m
MEMBRANE = Preset().with_values({"contact_test": "membrane", "membrane.bias_m": 0.0})


@pytest.fixture(scope="module")
def rig() -> Rig:
    """Two cameras in one place, so that pixels compare one by one."""
    lens = Intrinsics(width=WIDTH, height=HEIGHT, fx=230.0, fy=225.0, cx=159.5, cy=119.5)
    camera = DepthCamera(intrinsics=lens, depth_unit_m=UNIT_M)
    return Rig(proximity=camera, tactile=camera, T_proximity_tactile=np.eye(4).tolist())


def sphere_from_inside(rig: Rig, radius_m: float, middle_m: tuple[float, float, float]) -> np.ndarray:
    """Depth of a sphere's far side along each pixel's ray."""
    rays = np.dstack([rig.tactile.intrinsics.rays(), np.ones((HEIGHT, WIDTH))])
    middle = np.array(middle_m)
    along, square = rays @ middle, (rays**2).sum(axis=2)
    return (along + np.sqrt(along**2 - square * (middle @ middle - radius_m**2))) / square


def counts(depth_m: np.ndarray) -> np.ndarray:
    return np.rint(depth_m / UNIT_M).astype(np.uint16)


@pytest.mark.parametrize(("radius_m", "middle_m"), [(0.30, (0.0, 0.0, 0.0)), (0.25, (0.02, -0.03, 0.05))])
@pytest.mark.parametrize(("scale", "offset_m"), [(1.0, 0.0), (1.02, 0.004)])
def test_a_sphere_bulges_by_two_over_its_radius(rig, radius_m, middle_m, scale, offset_m):
    depth = (sphere_from_inside(rig, radius_m, middle_m) - offset_m) / scale
    frame = SensorFrame(0, counts(depth), counts(depth), np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    preset = MEMBRANE.with_values({"alignment.depth_scale": scale, "alignment.depth_offset_m": offset_m})
    bulge = bulge_per_m(frame, preset, rig)
    assert bulge.shape == (HEIGHT // 4, WIDTH // 4)
    np.testing.assert_allclose(bulge, 2 / radius_m, rtol=0.25)  # at the very border windows end
    np.testing.assert_allclose(bulge[9:-9, 9:-9], 2 / radius_m, rtol=0.03)


def test_where_too_little_depth_is_known_nothing_is_told(rig):
    depth = counts(sphere_from_inside(rig, 0.3, (0, 0, 0)))
    depth[:, 160:] = 0
    frame = SensorFrame(0, depth, depth, np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    bulge = bulge_per_m(frame, MEMBRANE, rig)
    assert np.isnan(bulge[:, 48:]).all()
    np.testing.assert_allclose(bulge[8:-8, 8:32], 2 / 0.3, rtol=0.12)


def plates(rig: Rig, right_gap_m: float) -> tuple[SensorFrame, SensorFrame]:
    """A round membrane that a plate flattens on the left, and to which one fits on the right; then the latter alone."""
    free = sphere_from_inside(rig, 0.3, (0.0, 0.0, 0.0))
    rays = rig.tactile.intrinsics.rays()
    normal = np.array([-0.28, 0.0, 1.0]) / np.hypot(0.28, 1.0)
    plate = 0.293 / (rays @ normal[:2] + normal[2])
    pressed = np.minimum(free, plate)
    left = np.hypot(rays[..., 0] + 0.28, rays[..., 1]) < 0.20
    right = np.hypot(rays[..., 0] - 0.28, rays[..., 1]) < 0.14
    color = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    touching = np.where(left, np.maximum(plate, pressed), np.where(right, free + right_gap_m, BEHIND_M))
    return (
        SensorFrame(0, counts(touching), counts(pressed), color),
        SensorFrame(1, counts(np.where(right, free + right_gap_m, BEHIND_M)), counts(free), color),
    )


def test_what_presses_is_contact_and_what_is_close_is_not(rig):
    both, hovering = scenes = plates(rig, 0.0005)
    asked, unasked = MEMBRANE, MEMBRANE.with_value("membrane.curvature", 0.0)
    patch = ContactPipeline(asked, rig).process(both)
    assert patch.mask[:, :140].sum() > 2000
    assert patch.mask[20:-20, 180:300].sum() == 0
    assert (patch.provenance[115:125, 215:230] == Provenance.NOT_PRESSED).all()
    assert ContactPipeline(asked, rig).process(hovering).mask[20:-20, 180:300].sum() == 0
    for scene in scenes:
        assert ContactPipeline(unasked, rig).process(scene).mask[20:-20, 180:300].sum() > 1000


def test_what_presses_too_lightly_to_be_told_is_contact_beside_firm_contact_with_its_gap(rig):
    both, alone = plates(rig, -0.0001)
    pipeline = ContactPipeline(MEMBRANE, rig)
    patch = pipeline.process(both)
    assert patch.mask[115:125, 215:230].all()
    assert patch.mask[:, :140].sum() > 2000
    assert pipeline.process(alone).mask[20:-20, 180:300].sum() == 0


def test_what_seems_to_be_before_the_membrane_is_no_light_contact(rig):
    both, _ = plates(rig, -0.003)
    assert ContactPipeline(MEMBRANE, rig).process(both).mask[20:-20, 180:300].sum() == 0


FIRM, LIGHT, MAX_DIFFERENCE_M = np.s_[2:12, 2:12], np.s_[20:30, 20:30], 0.0014


def groups_of_contact(firm_gap_m=0.0004, light_gap_m=0.0004, light_is_firm=0, firm_is_firm=100) -> tuple:
    """Return two groups of 100 pixels with one gap each and some firm pixels, and a background with gap 0."""
    contact, firm = np.zeros((40, 40), bool), np.zeros((40, 40), bool)
    gap_m = np.zeros((40, 40), np.float32)
    for place, gap, count in ((FIRM, firm_gap_m, firm_is_firm), (LIGHT, light_gap_m, light_is_firm)):
        contact[place], gap_m[place] = True, gap
        firm[place] = (np.arange(100) < count).reshape(10, 10)
    return firm, contact, gap_m


@pytest.mark.parametrize(
    ("light_gap_m", "kept"), [(0.0004, True), (0.0005, False), (-0.0006, True), (-0.0009, True), (-0.0011, False)]
)
def test_light_contact_has_no_larger_gap_than_firm_contact_and_none_far_smaller(light_gap_m, kept):
    firm, contact, gap_m = groups_of_contact(light_gap_m=light_gap_m)
    found = with_light_contact(firm, contact, gap_m, MAX_DIFFERENCE_M)
    assert found[LIGHT].all() if kept else not found[LIGHT].any()
    assert found[FIRM].all()
    assert not found[~contact].any()


@pytest.mark.parametrize(("light_is_firm", "kept"), [(20, True), (21, False)])
def test_a_group_of_which_more_is_firm_is_not_taken_whole(light_is_firm, kept):
    firm, contact, gap_m = groups_of_contact(light_gap_m=0.0, light_is_firm=light_is_firm)
    assert with_light_contact(firm, contact, gap_m, MAX_DIFFERENCE_M)[LIGHT].sum() == (100 if kept else 21)


@pytest.mark.parametrize(("firm_is_firm", "kept"), [(100, True), (99, False)])
def test_little_firm_contact_is_no_measure_of_others(firm_is_firm, kept):
    firm, contact, gap_m = groups_of_contact(firm_is_firm=firm_is_firm)
    assert with_light_contact(firm, contact, gap_m, MAX_DIFFERENCE_M)[LIGHT].any() == kept


def test_a_group_is_no_measure_of_itself():
    contact, firm = np.zeros((40, 40), bool), np.zeros((40, 40), bool)
    contact[2:32, 2:32], firm[2:32, 2:7] = True, True
    found = with_light_contact(firm, contact, np.zeros((40, 40), np.float32), MAX_DIFFERENCE_M)
    np.testing.assert_array_equal(found, firm)


def test_light_groups_are_judged_one_by_one():
    firm, contact, gap_m = groups_of_contact()
    contact[16:34, 16], contact[16, 16:34] = True, True  # an angle around the other group
    gap_m[16:34, 16], gap_m[16, 16:34] = 0.001, 0.001
    contact[36, 20:29], gap_m[36, 20:29] = True, 0.0  # too few pixels
    found = with_light_contact(firm, contact, gap_m, MAX_DIFFERENCE_M)
    assert found[LIGHT].all() and found.sum() == 200


def test_a_membrane_that_does_not_bulge_tells_nothing(rig):
    flat = np.full((HEIGHT, WIDTH), 0.3)
    touched = flat + np.where(np.hypot(*(np.mgrid[:HEIGHT, :WIDTH] - 100)) < 30, 0.0, 0.5)
    frame = SensorFrame(0, counts(touched), counts(flat), np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    unasked = MEMBRANE.with_value("membrane.curvature", 0.0)
    one, other = (ContactPipeline(preset, rig).process(frame) for preset in (unasked, MEMBRANE))
    assert one.mask.sum() > 2000
    np.testing.assert_array_equal(one.mask, other.mask)


@pytest.mark.parametrize("model", ["rigid", "homography"])
@pytest.mark.parametrize("distortion", ["none", "brown_conrady", "inverse_brown_conrady"])
def test_tactile_pixels_are_those_whose_depth_is_compared(make_rig, make_frame, model, distortion):
    rig = make_rig(distortion=distortion, bend=0.02)
    frame = make_frame(rig, 3, share_missing=0.0)
    # every tactile pixel has a depth of its own, so that the depth tells which one was taken
    numbered = np.arange(1, frame.tactile_depth.size + 1, dtype=np.uint16).reshape(frame.tactile_depth.shape)
    preset = Preset().with_value("alignment.model", model)
    alignment = make_alignment(preset.alignment, rig)
    height, width = frame.proximity_depth.shape
    measured = alignment.align(frame.proximity_depth, numbered, Region(0, 0, width, height)).measured_m.reshape(-1)
    depth = (frame.proximity_depth * np.float32(rig.proximity.depth_unit_m)).reshape(-1)
    u, v = alignment.tactile_pixels(np.arange(depth.size), depth, rig)
    tactile_height, tactile_width = numbered.shape
    column, row = np.floor(u + 0.5), np.floor(v + 0.5)
    inside = (column >= 0) & (column < tactile_width) & (row >= 0) & (row < tactile_height)
    taken = np.rint(measured / rig.tactile.depth_unit_m) - 1
    assert inside.sum() > 1000
    same = (row * tactile_width + column)[inside] == taken[inside]
    assert same.mean() > 0.999  # float32 and float64 may fall on either side of a pixel's border
    assert np.isnan(measured[~inside]).all()


def test_behind_the_camera_there_is_no_tactile_pixel(rig):
    pose = np.eye(4)
    pose[2, 3] = 1.0  # the tactile camera stands a metre in front of the proximity camera
    far = rig.model_copy(update={"T_proximity_tactile": pose.tolist()})
    u, v = make_alignment(Preset().alignment, far).tactile_pixels(np.arange(5), np.full(5, 0.3, np.float32), far)
    assert np.isnan([u, v]).all()


@pytest.mark.parametrize(("width", "height"), [(1, 1), (3, 3), (40, 3), (4, 4), (5, 7), (17, 9), (31, 33), (97, 65)])
@pytest.mark.parametrize("kind", ["flat", "zero", "saturated", "random"])
def test_images_of_any_size_and_content_are_judged(width, height, kind):
    rig = one_place_rig(width, height, 60.0, UNIT_M, UNIT_M)
    image = np.full((height, width), {"flat": 30_000, "saturated": 65_535}.get(kind, 0), np.uint16)
    if kind == "random":
        image = np.random.default_rng(0).integers(0, 65_536, image.shape).astype(np.uint16)
    frame = SensorFrame(0, image, image, np.zeros((height, width, 3), np.uint8))
    loose = MEMBRANE.with_values({"membrane.min_area_mm2": 0.0, "membrane.frames": 3})
    patch = ContactPipeline(loose, rig).process(frame)
    assert patch.mask.shape == (height, width)
    assert np.isfinite(patch.points).all()
