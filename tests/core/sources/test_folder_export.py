"""Exports to folders of images are atomic and never overwrite other files."""

import pytest

from folder_scenes import list_source, make_frame
from tactune.core.errors import ExportError
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


def test_an_export_overwrites_nothing(tmp_path):
    target = tmp_path / "out"
    target.mkdir()
    (target / "notes.txt").write_text("mine")
    with pytest.raises(ExportError, match=r"out is already there and not an empty folder; choose another name"):
        export_folder(list_source([make_frame(0)]), target)
    assert [path.name for path in target.iterdir()] == ["notes.txt"]
    (target / "notes.txt").unlink()
    export_folder(list_source([make_frame(0)]), target)
    assert FolderSource(target).length == 1
    with pytest.raises(ExportError, match="already there"):
        export_folder(list_source([make_frame(0)]), "/")
    file = tmp_path / "file"
    file.write_text("mine")
    with pytest.raises(ExportError, match="already there"):
        export_folder(list_source([make_frame(0)]), file)
    assert file.read_text() == "mine"
