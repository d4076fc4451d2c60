"""Work on a scan survives closing and crashing."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tactune.app.analysis.truth_state import FrozenPatch, PickedPair, TruthKeeper, TruthSession, TruthState
from tactune.core.evaluation.scan.paint import PaintSettings
from tactune.core.evaluation.scan.pose import load_transform
from truth_scene import click_pair, click_three_pairs, corners, open_tab, settle

POSE = ((0.0, -1.0, 0.0, 0.1), (1.0, 0.0, 0.0, 0.2), (0.0, 0.0, 1.0, 0.3), (0.0, 0.0, 0.0, 1.0))


def patch(seed: int = 0) -> FrozenPatch:
    points = np.random.default_rng(seed).uniform(0.1, 0.3, (50, 3)).astype(np.float32)
    return FrozenPatch(points, points[:20] + np.float32(0.01), 812.5, "sim:cup", 7, "default")


def state() -> TruthState:
    return TruthState(
        paint=PaintSettings(hue=(160, 5), largest=2),
        pairs=(PickedPair((0.1, 0.2, 0.3), (0.4, 0.5, 0.6)), PickedPair(scan=(0.0, 0.1, 0.0))),
        pose=POSE,
        origin="ICP",
        patch=patch(),
    )


class Kept:
    """A session and its keeper, and the sentences that were said."""

    def __init__(self, folder: Path, key: str = "abc0") -> None:
        self.session = TruthSession()
        self.keeper = TruthKeeper(self.session, folder)
        self.sentences: list[str] = []
        self.keeper.failed.connect(self.sentences.append)
        self.kept_at = self.keeper.switch_to(key)

    def close(self) -> None:
        self.keeper.close()
        self.session.close()


def test_everything_comes_back_with_its_patch(qapp, tmp_path):
    first = Kept(tmp_path)
    assert first.kept_at is None
    first.session.edit("All", state())
    first.close()
    second = Kept(tmp_path)
    assert second.session.state == state()
    assert second.kept_at is not None
    assert not second.session.undo_stack.canUndo()
    assert load_transform(second.keeper.transform_file) == POSE
    second.close()
    assert Kept(tmp_path, "abc1").session.state.empty, "another scan has work of its own"


def test_turning_between_scans_keeps_each_ones_work(qapp, tmp_path):
    kept = Kept(tmp_path)
    kept.session.edit("All", state())
    assert kept.keeper.switch_to("abc1") is None
    kept.session.edit("Paint", replace(TruthState(), paint=PaintSettings(largest=5)))
    assert kept.keeper.switch_to("abc0") is not None
    assert kept.session.state == state()
    kept.close()
    assert Kept(tmp_path, "abc1").session.state.paint.largest == 5


@pytest.mark.parametrize(
    "harm", [Path.unlink, lambda file: file.write_bytes(b""), lambda file: file.write_bytes(file.read_bytes()[:100])]
)
def test_a_lost_patch_leaves_pairs_and_pose_and_is_replaced_when_it_is_kept_again(qapp, tmp_path, harm):
    first = Kept(tmp_path)
    first.session.edit("All", state())
    first.close()
    (images,) = tmp_path.glob("patch-*.npz")
    harm(images)
    second = Kept(tmp_path)
    assert "gone" in second.sentences[0]
    assert second.session.state == replace(state(), patch=None)
    second.session.edit("All", state())
    second.close()
    third = Kept(tmp_path)
    assert third.sentences == []
    assert third.session.state == state()


def test_what_is_damaged_is_set_aside_and_told(qapp, tmp_path):
    (tmp_path / "scan-abc0.json").write_text('{"version": 1, "pairs":', encoding="utf-8")
    kept = Kept(tmp_path)
    assert kept.kept_at is None
    assert "set aside" in kept.sentences[0]
    assert (tmp_path / "scan-abc0.damaged").exists()
    kept.session.edit("All", state())
    kept.close()
    assert Kept(tmp_path).session.state == state()


def test_patches_that_nobody_needs_are_removed(qapp, tmp_path):
    kept = Kept(tmp_path)
    for seed in range(3):
        kept.session.edit("Patch", replace(state(), patch=patch(seed)))
        kept.keeper.flush()
    kept.close()
    assert len(list(tmp_path.glob("patch-*.npz"))) == 3, "another window may be about to name them"
    for file in tmp_path.glob("patch-*.npz"):
        os.utime(file, (1e9, 1e9))
    Kept(tmp_path).close()
    assert [file.name for file in tmp_path.glob("patch-*.npz")] == [f"patch-{patch(2).digest}.npz"]


def test_a_folder_that_cannot_be_written_is_told_once(qapp, qtbot, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    kept = Kept(blocked)
    for seed in range(2):
        kept.session.edit("Patch", replace(state(), patch=patch(seed)))
        kept.keeper.flush()
    qtbot.waitUntil(lambda: len(kept.sentences) > 0)
    kept.close()
    assert len(kept.sentences) == 1
    assert "cannot be kept safe" in kept.sentences[0]


def test_a_window_that_is_opened_again_goes_on_where_it_was(qtbot, make_window, window, plate, ready):
    click_three_pairs(ready)
    click_pair(ready, corners(ready)[0] * (1, 1, 1))
    before = ready.flow.state
    window.close_without_asking()
    qtbot.waitUntil(window.worker.isFinished)
    again = open_tab(qtbot, make_window())
    again.open_scan(plate)
    settle(qtbot, again)
    assert again.flow.state == before
    assert any("was restored" in sentence for sentence in again.messages.sentences())
    assert again.views.patch.point_count() == len(before.patch.points), "the patch is there without any source"
    qtbot.waitUntil(lambda: again.flow.scores is not None)
