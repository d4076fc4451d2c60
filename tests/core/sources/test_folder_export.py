"""Exports to folders of images."""

import pytest

from folder_scenes import list_source, make_frame
from tactune.core.sources.folder import FolderSource, export_folder


def test_export_starts_at_the_position_and_stops_after_so_many_frames(tmp_path):
    source = list_source([make_frame(seed) for seed in range(5)])
    source.seek(1)
    told = []
    assert export_folder(source, tmp_path / "out", frames=3, progress=lambda share, _: told.append(share)) == 3
    assert [frame.sequence for frame in FolderSource(tmp_path / "out")] == [101, 102, 103]
    assert told == pytest.approx([1 / 3, 2 / 3, 1.0])
    assert export_folder(source, tmp_path / "rest", frames=9, progress=lambda share, _: told.append(share)) == 1
    assert told[-1] == 1.0
