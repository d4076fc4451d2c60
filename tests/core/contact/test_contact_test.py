"""The membrane contact test as an option of the pipeline."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reference_patches import same_patch
from rigs import one_place_rig
from tactune.core.contact.alignment import make_alignment
from tactune.core.contact.masking import in_hsv_range
from tactune.core.contact.membrane.frame_bias import rig_bias
from tactune.core.contact.membrane.steps import classify, differences_at
from tactune.core.contact.membrane.test import MembraneTest
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.contact.pixels import Pixels, Workspace, colors_at
from tactune.core.model.clouds import ray_table
from tactune.core.model.frames import SensorFrame
from tactune.core.model.patch import Provenance
from tactune.core.preset import Preset

WIDTH, HEIGHT = 200, 120
MEMBRANE_M = 0.3
MEMBRANE = Preset().with_values({"contact_test": "membrane", "membrane.bias": False})
PRINT_RGB = (200, 30, 120)
_CAMERA = {"white_m": 0.001, "correlated_m": 0.0, "length_px": 0.0, "changing_share": 1.0, "distance_m": MEMBRANE_M}
NOISE = {"proximity": _CAMERA, "tactile": _CAMERA, "bias_m": 0.0004, "bias_sigma_m": 0.0003, "bias_from": "prints",
         "measured": "2026-01-02T03:04:05Z", "frames": 30}  # fmt: skip


@pytest.fixture(scope="module")
def rig():
    """Two cameras in one place, so that pixels compare one by one."""
    return one_place_rig(WIDTH, HEIGHT, 300.0, 1e-5, 1e-5)


def frame_of(gap_m, color=None):
    """A flat membrane and an object so far behind it; nan where the proximity camera sees nothing."""
    proximity = np.nan_to_num(np.rint((MEMBRANE_M + gap_m) / 1e-5)).astype(np.uint16)
    tactile = np.full((HEIGHT, WIDTH), round(MEMBRANE_M / 1e-5), np.uint16)
    return SensorFrame(0, proximity, tactile, np.zeros((HEIGHT, WIDTH, 3), np.uint8) if color is None else color)


@pytest.fixture(scope="module")
def scene():
    """A disc in contact that leaves by the square of the way; beside it whatever else pixels can be."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    r = np.hypot(u - 60, v - 60)
    gap = np.where(r < 25, 0.0, 3e-5 * (r - 25) ** 2)
    gap[gap > 0.02] = 0.1
    gap[16:28, 138:150] = 0.0  # small, at 1 mm2 a pixel
    gap[60, 140] = 0.0  # lone
    gap[60, 60] = np.nan  # a hole inside
    gap[80:100, 170:190] = np.nan
    color = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    color[50:70, 70:75] = PRINT_RGB
    return frame_of(gap, color)


def masked(preset):
    return preset.with_values({"mask.enabled": True, "mask.saturation": (100, 255), "mask.value": (100, 255)})


def test_every_pixel_has_the_reason_why_it_was_kept_or_dropped(rig, scene):
    preset = masked(MEMBRANE).with_values({"membrane.min_area_mm2": 200.0})
    limits = {"region.enabled": True, "region.rectangle": (0, 0, 196, HEIGHT), "range.enabled": True,
              "range.limits_m": (0.1, 0.35)}  # fmt: skip
    patch = ContactPipeline(preset.with_values(limits), rig).process(scene)
    expected = {
        (60, 60): Provenance.CONTACT,  # no depth of its own, but its neighbours tell
        (60, 50): Provenance.CONTACT,
        (60, 30): Provenance.RIM,
        (60, 24): Provenance.OUTSIDE_TOLERANCE,
        (22, 142): Provenance.SMALL_CLUSTER,
        (60, 140): Provenance.OUTSIDE_TOLERANCE,  # lone
        (60, 72): Provenance.MASKED,
        (90, 180): Provenance.NO_PROXIMITY_DEPTH,
        (10, 198): Provenance.OUTSIDE_REGION,
        (10, 100): Provenance.OUTSIDE_RANGE,
    }
    assert {pixel: Provenance(int(patch.provenance[pixel])) for pixel in expected} == expected
    np.testing.assert_array_equal(patch.mask, patch.provenance == Provenance.CONTACT)
    assert all(verdict.explanation.endswith(".") for verdict in Provenance)


def test_a_range_around_the_membrane_changes_no_patch(rig, scene):
    """What lies far behind tells that the membrane is free there, also where the range ends before it."""
    limited = MEMBRANE.with_values({"range.enabled": True, "range.limits_m": (0.1, 0.35)})
    whole, patch = (ContactPipeline(preset, rig).process(scene) for preset in (MEMBRANE, limited))
    np.testing.assert_array_equal(patch.mask, whole.mask)
    np.testing.assert_array_equal(patch.points, whole.points)


def test_points_belong_to_the_masks_pixels_in_order_and_lie_between_both_surfaces(rig, scene):
    patch = ContactPipeline(MEMBRANE, rig).process(scene)
    rays = ray_table(rig.proximity.intrinsics)[patch.mask]
    np.testing.assert_allclose(patch.points[:, :2] / patch.points[:, 2:], rays, atol=1e-6)
    z = patch.points[:, 2].astype(float)
    assert z.min() > MEMBRANE_M - 1e-6
    assert z.max() < MEMBRANE_M + 0.0009
    reach_mm = 25 + np.sqrt(MEMBRANE.membrane.gap_m / 3e-5)  # where the gap is the largest one
    disc = patch.mask & (np.mgrid[:HEIGHT, :WIDTH][1] < 120)
    assert disc.sum() == pytest.approx(np.pi * reach_mm**2, rel=0.05)


@pytest.mark.parametrize(
    ("path", "value", "repeated"),
    [
        ("membrane.min_area_mm2", 9.0, {"clusters", "points"}),
        ("membrane.gap_m", 0.001, {"edge", "clusters", "points"}),
        ("membrane.trust_m", 0.008, {"equilibrium", "edge", "clusters", "points"}),
        ("membrane.shape_px", 8.0, {"equilibrium", "edge", "clusters", "points"}),
        ("membrane.bias", True, set(MembraneTest.steps)),
        ("noise", NOISE, set(MembraneTest.steps)),
        ("mask.value", (120, 255), set(MembraneTest.steps)),
        ("alignment.depth_offset_m", 0.0001, set(MembraneTest.steps)),
        ("tolerance.t", 0.5, set()),
        ("outliers.k", 9, set()),
        ("outliers.min_cluster_area_mm2", 1e5, set()),
    ],
)
def test_a_change_repeats_only_what_comes_after_it(rig, scene, path, value, repeated):
    preset = masked(MEMBRANE)
    contact = ContactPipeline(preset, rig)
    first = contact.process(scene)
    assert tuple(first.stage_ms) == tuple(MembraneTest.steps)
    assert all(first.stage_ms.values())
    changed = preset.with_value(path, value)
    contact.update(changed)
    again = contact.process(scene)
    assert {name for name, ms in again.stage_ms.items() if ms > 0} == repeated
    assert again.skipped == (() if repeated else ("nothing changed",))
    assert same_patch(again, ContactPipeline(changed, rig).process(scene))


choices = st.fixed_dictionaries(
    {
        "contact_test": st.sampled_from(["tolerance", "membrane", "membrane"]),
        "alignment.model": st.sampled_from(["rigid", "homography"]),
        "alignment.depth_offset_m": st.sampled_from([0.0, 0.002, 0.05]),
        "mask.enabled": st.booleans(),
        "mask.saturation": st.sampled_from([(0, 120), (60, 255)]),
        "membrane.gap_m": st.sampled_from([0.0, 0.0005, 0.005]),
        "membrane.trust_m": st.sampled_from([0.004, 0.016, 0.05]),
        "membrane.shape_px": st.sampled_from([1.0, 4.0]),
        "membrane.bias": st.booleans(),
        "noise": st.sampled_from([None, NOISE]),
        "membrane.min_area_mm2": st.sampled_from([0.0, 25.0, 1e5]),
        "region.enabled": st.booleans(),
        "region.rectangle": st.tuples(st.integers(0, 60), st.integers(0, 50), st.integers(1, 99), st.integers(1, 99)),
    }
)


@settings(max_examples=60, deadline=None)
@given(first=choices, between=choices, then=st.none() | choices, new_frame=st.booleans())
def test_memory_never_changes_a_result_whichever_the_test(make_rig, make_frame, first, between, then, new_frame):
    """Nor does a change that is taken back before the next frame."""
    then = then or first
    rig = make_rig()
    frame = make_frame(rig, 1, 0.001)
    used = ContactPipeline(Preset().with_values(first), rig)
    used.process(frame)
    used.update(Preset().with_values(between))
    used.update(Preset().with_values(then))
    if new_frame:
        frame = make_frame(rig, 2, 0.001)
    patch = used.process(frame)
    assert same_patch(patch, ContactPipeline(Preset().with_values(then), rig).process(frame))
    assert len(patch.points) == patch.mask.sum()
    assert np.isfinite(patch.points).all()
    np.testing.assert_array_equal(patch.mask, patch.provenance == Provenance.CONTACT)


@settings(max_examples=60, deadline=None)
@given(
    width=st.sampled_from([80, 73, 64, 17, 9]), seed=st.integers(0, 1000), color=st.booleans(), mask=st.booleans(),
    model=st.sampled_from(["rigid", "homography"]), distortion=st.sampled_from(["none", "brown_conrady"]),
    rectangle=st.tuples(st.integers(0, 8), st.integers(0, 50), st.integers(1, 99), st.integers(1, 99)),
)  # fmt: skip
def test_differences_are_those_of_whole_images(
    make_rig, make_frame, width, seed, color, mask, model, distortion, rectangle
):
    rig = make_rig(width=width, color=color, distortion=distortion, bend=0.02)
    frame = make_frame(rig, seed)
    preset = MEMBRANE.with_values(
        {"mask.enabled": mask, "mask.saturation": (60, 255), "alignment.model": model, "region.enabled": True,
         "region.rectangle": rectangle, "range.enabled": True, "range.limits_m": (0.27, 0.5),
         "membrane.bias": False, "membrane.min_area_mm2": 0.0}
    )  # fmt: skip
    pixels = Pixels(preset, rig, make_alignment(preset.alignment, rig), Workspace(rig))
    aligned = pixels.aligned(frame)
    difference = aligned.expected_m - aligned.measured_m
    depth = frame.proximity_depth * np.float32(rig.proximity.depth_unit_m)
    usable = (np.abs(difference) < np.float32(0.008)) & (depth >= np.float32(0.27)) & (depth <= np.float32(0.5))
    if mask:
        points = np.dstack([ray_table(rig.proximity.intrinsics) * depth[..., None], depth]).reshape(-1, 3)
        colors, seen = colors_at(points.astype(np.float32), np.arange(depth.size), frame.proximity_color, rig)
        usable &= ~(in_hsv_range(colors, preset.mask) & seen).reshape(usable.shape)

    found = differences_at(frame, pixels, preset.membrane, rig_bias(None, rig))
    assert (found is None) == (not usable.any())
    verdicts = classify(frame, preset, pixels)
    if mask:
        masked_out = verdicts == Provenance.MASKED
        assert not (masked_out & usable).any()
    if found is not None:
        np.testing.assert_array_equal(found.usable, usable[found.place])
        assert found.usable.sum() == usable.sum()
        np.testing.assert_array_equal(found.difference_m[found.usable], difference[found.place][found.usable])
