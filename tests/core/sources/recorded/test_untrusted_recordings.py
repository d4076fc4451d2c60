"""Damaged RealSense recordings: one sentence, or what is whole plays."""

import numpy as np
import pytest

from bag_maker import D405, L515, make_bag


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
