"""``tactune preset create-rig``: the rig of a folder of images, without a window."""

import cv2
import pytest

from tactune.core.model.rig_file import load_rig


@pytest.fixture
def bare(recording):
    """A recording without its rig."""
    (recording / "rig.json").unlink()
    return recording


def test_the_message_of_a_folder_without_a_rig_names_the_command_and_that_makes_it_a_source(tactune, bare):
    refused = tactune("run", "--source", bare, "--json")
    assert refused.status == 2 and "rig.json" in refused.err and "tactune preset create-rig" in refused.err
    assert tactune("preset", "create-rig", bare, "--proximity", "L515=60,61,31.5,23.5", "--tactile", "D405").status == 0
    rig = load_rig(bare / "rig.json")
    lens = rig.proximity.intrinsics
    assert (lens.fx, lens.fy, lens.cx, lens.cy) == (60, 61, 31.5, 23.5)
    assert (rig.proximity.model, rig.tactile.model) == ("L515", "D405")
    assert (rig.proximity.depth_unit_m, rig.tactile.depth_unit_m) == (0.00025, 0.0001)
    info = tactune("preset", "create-rig", bare, "--proximity", "L515", "--tactile", "D405")
    assert info.status == 2 and "already there" in info.err


def test_what_is_assumed_is_said(tactune, bare):
    for path in bare.rglob("proximity_color.png"):
        cv2.imwrite(str(path), cv2.resize(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), (48, 30)))
    unknown = tactune("create-rig", bare, "--proximity", "D435=60,61,31.5,23.5")
    assert unknown.status == 2 and "lens of the tactile camera is unknown" in unknown.err
    done = tactune("create-rig", bare, "--proximity", "D435=60,61,31.5,23.5", "--tactile", "D405", "--unit", "mm")
    assert done.status == 0
    assert "the pose of the colour camera is unknown, so its images are left out" in done.err
    assert load_rig(bare / "rig.json").proximity_color is None
    assert "the depth lens of the D405 is the maker's" in done.err
    assert "depth lens of the D435" not in done.err
