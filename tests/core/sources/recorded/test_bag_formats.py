"""Variants of librealsense's bags: lenses, colour and depth layouts, units."""

import numpy as np
import pytest

from bag_maker import Device, color_images, depth_images, make_bag
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


@pytest.mark.parametrize(("encoding", "order"), [("rgb8", [0, 1, 2]), ("bgr8", [2, 1, 0])])
@pytest.mark.parametrize("alpha", [False, True])
def test_colour_orders(open_bag, tmp_path, encoding, order, alpha):
    rgb = color_images(7, [1.0]).images[0]
    stored = rgb[:, :, order]
    if alpha:
        stored = np.dstack([stored, np.full(rgb.shape[:2], 255, np.uint8)])
        encoding = encoding.replace("8", "a8")
    color = color_images(7, [1.0], images=[stored], encoding=encoding, padding=5)
    two = Device("L515", depth_images(4, [1.0]), color), Device("D405", depth_images(5, [1.0]))
    frame = open_bag(make_bag(tmp_path / "two.bag", *two)).read(0)
    np.testing.assert_array_equal(frame.proximity_color, rgb)


@pytest.mark.parametrize("changes", [{"padding": 6}, {"big_endian": True}, {"encoding": "16UC1"}])
def test_depth_layouts(open_bag, tmp_path, changes):
    depth = depth_images(4, [1.0], **changes)
    frame = open_bag(make_bag(tmp_path / "one.bag", Device("L515", depth))).read(0)
    np.testing.assert_array_equal(frame.proximity_depth, depth.images[0])
    assert frame.proximity_depth.dtype == np.dtype("=u2")
