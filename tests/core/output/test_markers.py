"""Markers beside a recording: round trip, damaged files, places."""

from __future__ import annotations

import pytest

from tactune.core.errors import SourceError
from tactune.core.output.markers import Marker, Marks, load_marks, markers_file, save_marks

MARKS = Marks(
    markers=(Marker(frame=40, name="höher", time_s=1.3), Marker(frame=7, name="first touch", time_s=0.2)), trim=(5, 60)
)


def test_comes_back_as_saved_in_the_order_of_the_frames(tmp_path):
    file = tmp_path / "press.mcap.markers.json"
    assert load_marks(file) == Marks()
    save_marks(file, MARKS)
    assert load_marks(file) == MARKS
    assert [marker.name for marker in load_marks(file).markers] == ["first touch", "höher"]
    assert [path.name for path in tmp_path.iterdir()] == [file.name]


@pytest.mark.parametrize(
    "text",
    [
        *("{", "[]", '{"markers": 3}', '{"trim": [9, 3]}', "\0ÿ"),
        '{"markers": [{"frame": -1, "name": "a", "time_s": 0}]}',
        '{"markers": [{"frame": 99999999999999999999, "name": "a", "time_s": 0}]}',
        '{"markers": [' + ", ".join(['{"frame": 1, "name": "a", "time_s": 0}'] * 10_001) + "]}",
    ],
    ids=range(8),
)
def test_a_damaged_file_is_explained_and_kept(tmp_path, text):
    file = tmp_path / "press.mcap.markers.json"
    file.write_text(text)
    with pytest.raises(SourceError, match=r"press\.mcap\.markers\.json are damaged"):
        load_marks(file)
    assert file.read_text() == text


def test_lies_beside_a_file_and_inside_a_folder(tmp_path):
    recording, folder = tmp_path / "press.mcap", tmp_path / "scene"
    recording.touch()
    folder.mkdir()
    assert markers_file(f"mcap:{recording}") == tmp_path / "press.mcap.markers.json"
    assert markers_file(f"bag:{recording},{recording}") == tmp_path / "press.mcap.markers.json"
    assert markers_file(f"folder:{folder}") == folder / "markers.json"
    assert markers_file("sim:cup") is None
    assert markers_file("sim") is None
