"""Damaged RealSense recordings: one sentence, or what is whole plays."""

from pathlib import Path

import numpy as np
import pytest

from bag_maker import D405, L515, make_bag
from tactune.core.errors import SourceError
from tactune.core.sources.realsense_files import BagSource

DATA = Path(__file__).parents[3] / "data"
BAG, ZSTD_DB3, PNG_DB3 = (DATA / name for name in ("l515_2.54.2.bag", "d405_2.58.4.db3", "d405_2.59.1.db3"))


@pytest.mark.parametrize("path", [BAG, ZSTD_DB3, PNG_DB3], ids=lambda path: path.name)
def test_a_file_cut_anywhere_is_refused_or_plays_what_is_whole(path, tmp_path):
    with BagSource(path) as source:
        frames = {frame.proximity_time_s: frame.proximity_depth for frame in source}
    whole, cut = path.read_bytes(), tmp_path / path.name
    for size in [*range(0, 200, 7), *range(200, len(whole), len(whole) // 40), len(whole) - 1]:
        cut.write_bytes(whole[:size])
        try:
            with BagSource(cut) as source:
                for frame in source:
                    np.testing.assert_array_equal(frame.proximity_depth, frames[frame.proximity_time_s])
        except SourceError as error:
            assert "copy it again" in str(error)


@pytest.mark.parametrize("has_index", [True, False])
def test_a_bag_whose_recorder_was_killed_plays_up_to_its_last_whole_chunk(tmp_path, open_bag, has_index):
    whole = make_bag(tmp_path / "whole.bag", D405, L515, compress=True).read_bytes()
    at = whole.index(b"index_pos=") + len(b"index_pos=")
    last_chunk = whole.rindex(b"compression=lz4", 0, whole.rindex(b"compression=lz4") - 400)
    path = tmp_path / "killed.bag"
    index_pos = whole[at : at + 8] if has_index else bytes(8)
    path.write_bytes(whole[:at] + index_pos + whole[at + 8 : last_chunk + 200])
    source = open_bag(path)
    assert "killed.bag was not finished when it was recorded" in source.health().message
    assert source.length == 2
    for index, frame in enumerate(source):
        np.testing.assert_array_equal(frame.proximity_depth, L515.depth.images[index])
        np.testing.assert_array_equal(frame.tactile_depth, D405.depth.images[index])
