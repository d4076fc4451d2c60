"""Variants of librealsense's bags: lenses, colour and depth layouts, units."""

import pytest

from bag_maker import Device, depth_images, make_bag
from tactune.core.model.intrinsics import Distortion


@pytest.mark.parametrize(
    ("model", "expected"),
    [
        ("None", Distortion.NONE),
        ("Brown Conrady", Distortion.BROWN_CONRADY),
        ("Modified Brown Conrady", Distortion.MODIFIED_BROWN_CONRADY),
        ("Inverse Brown Conrady", Distortion.INVERSE_BROWN_CONRADY),
    ],
)
def test_lens_models_keep_their_names_and_coefficients(open_bag, tmp_path, model, expected):
    depth = depth_images(4, [1.0], lens=model, D=(0.1, -0.2, 0.3, -0.4, 0.5))
    lens = open_bag(make_bag(tmp_path / "one.bag", Device("D435", depth))).rig.proximity.intrinsics
    assert lens.distortion is expected
    assert lens.coefficients == (0.1, -0.2, 0.3, -0.4, 0.5)
