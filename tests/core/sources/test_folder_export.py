"""Exports to folders of images are atomic and never overwrite other files."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from folder_scenes import RIG, ListSource, LiveSource, make_frame
from tactune.core.errors import ExportError, FrameError, SourceError
from tactune.core.model.frames import GroundTruth, Rig, SensorFrame
from tactune.core.sources.folder import FolderSource, export_folder


def test_export_starts_at_the_position_and_stops_after_so_many_frames(tmp_path: Path) -> None:
    source = ListSource([make_frame(seed) for seed in range(5)])
    source.seek(1)
    told: list[float] = []
    assert export_folder(source, tmp_path / "out", frames=3, progress=lambda share, _: told.append(share)) == 3
    assert [frame.sequence for frame in FolderSource(tmp_path / "out")] == [101, 102, 103]
    assert told == pytest.approx([1 / 3, 2 / 3, 1.0])
    assert export_folder(source, tmp_path / "rest", frames=9, progress=lambda share, _: told.append(share)) == 1
    assert told[-1] == 1.0


def test_a_live_source_is_exported_for_so_many_frames(tmp_path: Path) -> None:
    assert export_folder(LiveSource(), tmp_path / "out", frames=2) == 2
    with pytest.raises(ExportError, match=r"live is live.*how many frames"):
        export_folder(LiveSource(), tmp_path / "other")


def test_the_folder_has_its_name_only_when_it_is_complete(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "out"
    seen: list[bool] = []
    export_folder(ListSource([make_frame(0)]), target, progress=lambda *_: seen.append(target.exists()))
    assert seen == [False]
    assert (target / "rig.json").exists()
    assert os.listdir(target.parent) == ["out"]  # noqa: PTH208  # names only


def test_of_two_exports_into_one_folder_the_second_says_so(tmp_path: Path) -> None:
    def another(*_: object) -> None:
        export_folder(ListSource([make_frame(1)]), tmp_path / "out")

    with pytest.raises(ExportError, match="out was written by another program meanwhile; choose another name"):
        export_folder(ListSource([make_frame(0)]), tmp_path / "out", progress=another)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("error", [SourceError("the camera is gone"), KeyboardInterrupt(), OSError(28, "disk full")])
def test_a_broken_export_leaves_nothing(tmp_path: Path, error: BaseException) -> None:
    class Breaking(ListSource):
        def read(self, index: int) -> SensorFrame:
            if index == 1:
                raise error
            return super().read(index)

    expected = ExportError if isinstance(error, OSError) else type(error)
    with pytest.raises(expected):
        export_folder(Breaking([make_frame(0), make_frame(1)]), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_an_export_overwrites_nothing(tmp_path: Path) -> None:
    target = tmp_path / "out"
    target.mkdir()
    (target / "notes.txt").write_text("mine")
    with pytest.raises(ExportError, match=r"out is already there and not an empty folder; choose another name"):
        export_folder(ListSource([make_frame(0)]), target)
    assert [path.name for path in target.iterdir()] == ["notes.txt"]
    (target / "notes.txt").unlink()
    export_folder(ListSource([make_frame(0)]), target)
    assert FolderSource(target).length == 1
    with pytest.raises(ExportError, match="already there"):
        export_folder(ListSource([make_frame(0)]), "/")
    file = tmp_path / "file"
    file.write_text("mine")
    with pytest.raises(ExportError, match="already there"):
        export_folder(ListSource([make_frame(0)]), file)
    assert file.read_text() == "mine"


def test_what_cannot_be_exported_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="0 frames"):
        export_folder(ListSource([make_frame(0)]), tmp_path / "out", frames=0)
    with pytest.raises(ExportError, match="no frames left"):
        export_folder(ListSource([]), tmp_path / "out")
    small = Rig(proximity=RIG.tactile, tactile=RIG.tactile)
    with pytest.raises(FrameError, match="7 x 5 pixels, the rig says 6 x 4"):
        export_folder(ListSource([make_frame(0)], rig=small), tmp_path / "out")
    for change in ({"tactile_color": np.zeros((5, 6, 3), np.uint8)}, {"truth": GroundTruth(np.zeros((4, 7), bool))}):
        with pytest.raises(FrameError, match="leave it out"):
            export_folder(ListSource([make_frame(0, **change)]), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []
