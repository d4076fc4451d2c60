"""``tactune preset create-rig``: the rig of a folder of images, without a window."""

import shutil

import cv2
import numpy as np
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


def test_a_lens_is_fitted_to_pictures_of_a_chessboard(tactune, tmp_path, shared_data):
    folder, boards = tmp_path / "images", tmp_path / "boards"
    for made in (folder, boards):
        made.mkdir()
    for path in (shared_data / "stereo_boards").glob("left*.jpg"):
        shutil.copy(path, boards)
    for name in ("proximity_depth", "tactile_depth"):
        cv2.imwrite(str(folder / f"{name}.png"), np.full((480, 640), 300, np.uint16))
    cv2.imwrite(str(folder / "proximity_color.png"), np.ones((480, 640, 3), np.uint8))
    lenses = "--proximity", "L515", "--tactile", f"D405={boards}"
    assert tactune("preset", "create-rig", folder, *lenses, "--unit", "mm").status == 0
    assert load_rig(folder / "rig.json").tactile.intrinsics.fx == pytest.approx(535.9, rel=0.01)
