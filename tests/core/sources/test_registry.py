"""Names of sources: what each name opens, and one clear sentence for an invalid name."""

import pytest

from tactune.core.errors import SourceError
from tactune.core.sources.folder import FolderSource
from tactune.core.sources.registry import open_source


def test_a_folder_is_opened_by_scheme_or_by_its_rig(recording):
    for name in (f"folder:{recording}", str(recording), str(recording / "rig.json")):
        with open_source(name) as source:
            assert isinstance(source, FolderSource)
            assert source.name == f"folder:{recording}"
            assert source.length == 2


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("", r"'' is no source: nothing is at that path; .* sim:SCENE"),
        ("nowhere/at/all", r"'nowhere/at/all' is no source: nothing is at that path; .*folder:PATH, bag:PATH"),
        ("folder:", r"folder: needs a path, as in folder:PATH"),
        ("bag:", r"bag: needs a path, as in bag:PATH"),
        ("live:", r"live: needs another source, as in live:sim"),
        ("live:folder:nowhere", r"folder:nowhere: there is no folder nowhere"),
        ("realsense:1", r"cameras:1: give both serial numbers, as in cameras:f0090001,130322270002, or none"),
        ("folder:nowhere", r"folder:nowhere: there is no folder nowhere"),
        ("bag:nowhere", r"bag:nowhere: there is no file nowhere"),
        ("sim:table", "scene is 'table'"),
    ],
)
def test_a_name_that_opens_nothing_is_answered_in_one_sentence(name, sentence, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SourceError, match=sentence) as caught:
        open_source(name)
    assert "\n" not in str(caught.value)
