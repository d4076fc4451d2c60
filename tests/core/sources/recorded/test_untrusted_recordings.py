"""Damaged and malicious recordings: one sentence, limited memory and time."""

from __future__ import annotations

import sqlite3
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import numpy as np
import pytest

import bag_maker
from bag_maker import D405, L515, make_bag
from tactune.core.errors import SourceError
from tactune.core.sources.realsense_files.source import BagSource

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

DATA = Path(__file__).parents[3] / "data"
BAG, ZSTD_DB3, PNG_DB3 = (DATA / name for name in ("l515_2.54.2.bag", "d405_2.58.4.db3", "d405_2.59.1.db3"))
SCRIPT = Path(bag_maker.__file__).with_name("fuzz_recordings.py")


def test_random_damage_gives_frames_or_a_sentence(tmp_path: Path) -> None:
    made = [
        make_bag(tmp_path / "plain.bag", D405, L515),
        make_bag(tmp_path / "lz4.bag", D405, L515, compress=True),
    ]
    command = [sys.executable, SCRIPT, tmp_path, "1", "500", BAG, ZSTD_DB3, PNG_DB3, *made]
    result = subprocess.run([*map(str, command)], capture_output=True, text=True, timeout=300, check=False)
    assert result.returncode == 0, result.stderr
    readable, refused = map(int, result.stdout.split())
    assert readable + refused == 500
    assert refused > 250
    assert result.stderr == ""


@pytest.mark.parametrize("path", [BAG, ZSTD_DB3, PNG_DB3], ids=lambda path: path.name)
def test_a_file_cut_anywhere_is_refused_or_plays(path: Path, tmp_path: Path) -> None:
    whole = path.read_bytes()
    cut = tmp_path / path.name
    for size in [*range(0, 200, 7), *range(200, len(whole), len(whole) // 40), len(whole) - 1]:
        cut.write_bytes(whole[:size])
        try:
            with BagSource(cut) as source:
                list(source)
        except SourceError as error:
            assert "record it again" in str(error)
        else:
            pytest.fail(f"{size} of {len(whole)} bytes were enough")


def _record(fields: dict[bytes, bytes], data: bytes) -> bytes:
    header = b"".join(struct.pack("<I", len(k) + 1 + len(v)) + k + b"=" + v for k, v in fields.items())
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def _bag_around(chunks: list[tuple[bytes, int, str]]) -> bytes:
    """A bag whose chunks (bytes, claimed size, compression) hold one message of a depth topic each."""
    u32 = lambda value: struct.pack("<I", value)
    topic = b"/device_0/sensor_0/Depth_0/image/data"
    magic = b"#ROSBAG V2.0\n"
    counts = {b"conn_count": u32(1), b"chunk_count": u32(len(chunks))}
    head = lambda index: _record({b"op": b"\x03", b"index_pos": struct.pack("<Q", index)} | counts, b"")
    body, infos = b"", b""
    start = len(magic) + len(head(0))
    for data, size, compression in chunks:
        place = struct.pack("<Q", start + len(body))
        infos += _record({b"op": b"\x06", b"ver": u32(1), b"chunk_pos": place, b"count": u32(1)}, b"")
        body += _record({b"op": b"\x05", b"compression": compression.encode(), b"size": u32(size)}, data)
        body += _record({b"op": b"\x04", b"ver": u32(1), b"conn": u32(0), b"count": u32(1)}, bytes(12))
    connection = _record({b"op": b"\x07", b"conn": u32(0), b"topic": topic}, b"")
    return magic + head(start + len(body)) + body + connection + infos


def test_a_chunk_that_unpacks_to_more_than_it_says_is_refused(tmp_path: Path) -> None:
    bomb = lz4.frame.compress(bytes(2**28))
    path = tmp_path / "bomb.bag"
    path.write_bytes(_bag_around([(bomb, 1000, "lz4")]))
    with pytest.raises(SourceError, match=r"a chunk holds 1001 bytes instead of 1000"):
        BagSource(path)


@pytest.mark.parametrize(
    ("size", "sentence"),
    [(2**32 - 1, r"claims 4294967295 bytes, more than any camera writes"), (2**25, r"bytes claim to hold \d+ or more")],
)
def test_a_chunk_that_claims_too_much_is_refused_unread(tmp_path: Path, size: int, sentence: str) -> None:
    path = tmp_path / "claim.bag"
    path.write_bytes(_bag_around([(b"x" * 100, size, "lz4")] * 9))
    with pytest.raises(SourceError, match=sentence):
        BagSource(path)


def test_chunks_that_share_bytes_are_refused(tmp_path: Path) -> None:
    # One large chunk that a small file names a thousand times would be unpacked a thousand times.
    data = _bag_around([(b"x" * 100, 100, "none")] * 2)
    first, second = (data.index(b"op=\x05", at) for at in (0, data.index(b"op=\x05") + 1))
    place = lambda at: struct.pack("<Q", at - 8)
    path = tmp_path / "shared.bag"
    path.write_bytes(data.replace(b"chunk_pos=" + place(second), b"chunk_pos=" + place(first)))
    with pytest.raises(SourceError, match=r"its chunks overlap"):
        BagSource(path)


def _change(tmp_path: Path, source: Path, *statements: str, values: tuple[object, ...] = ()) -> Path:
    path = tmp_path / source.name
    path.write_bytes(source.read_bytes())
    with sqlite3.connect(path) as database:
        for statement in statements:
            database.execute(statement, values if "?" in statement else ())
    database.close()
    return path


def test_a_view_in_place_of_a_table_is_not_run(tmp_path: Path) -> None:
    endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i AS id, i AS topic_id FROM n"
    path = _change(tmp_path, PNG_DB3, "ALTER TABLE messages RENAME TO m", f"CREATE VIEW messages AS {endless}")
    with pytest.raises(SourceError, match=r"it has no tables of topics and messages"):
        BagSource(path)


def test_computed_columns_are_refused(tmp_path: Path) -> None:
    path = _change(tmp_path, PNG_DB3, "ALTER TABLE messages ADD COLUMN more AS (zeroblob(1000000000))")
    with pytest.raises(SourceError, match=r"its tables have computed columns"):
        BagSource(path)


def test_a_message_that_unpacks_to_gigabytes_is_refused(tmp_path: Path) -> None:
    bomb = zstd.compress(bytes(2**28))
    where = "topic_id = (SELECT id FROM topics WHERE name LIKE '%image/metadata')"
    path = _change(tmp_path, ZSTD_DB3, f"UPDATE messages SET data = ? WHERE {where}", values=(bomb,))
    with pytest.raises(SourceError, match=r"claims 268435456 bytes, more than any camera writes"):
        BagSource(path)


def test_a_png_of_another_size_than_the_lens_is_refused_before_it_is_decoded(tmp_path: Path) -> None:
    path = tmp_path / "huge.db3"
    size = struct.pack(">II", 48, 32)
    path.write_bytes(PNG_DB3.read_bytes().replace(b"IHDR" + size, b"IHDR" + struct.pack(">II", 16384, 65536)))
    with BagSource(path) as source, pytest.raises(SourceError, match=r"16384 x 65536 pixels"):
        source.next_frame()


def test_a_png_with_a_wrong_checksum_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "bit.db3"
    path.write_bytes(PNG_DB3.read_bytes().replace(b"IDATx", b"IDATy"))
    with (
        BagSource(path) as source,
        pytest.raises(SourceError, match=r"image \d of /device_0.*its PNG data are damaged"),
    ):
        list(source)
    assert capfd.readouterr().err == ""


def test_a_recording_without_images_says_so(tmp_path: Path) -> None:
    path = _change(tmp_path, PNG_DB3, "DELETE FROM messages WHERE timestamp > 0")
    with pytest.raises(SourceError, match=r"it holds no depth images"):
        BagSource(path)


def test_a_bag_whose_recorder_was_killed_plays_up_to_its_last_whole_chunk(
    tmp_path: Path, open_bag: Callable[..., BagSource]
) -> None:
    whole = make_bag(tmp_path / "whole.bag", D405, L515, compress=True).read_bytes()
    at = whole.index(b"index_pos=") + len(b"index_pos=")
    last_chunk = whole.rindex(b"compression=lz4", 0, whole.rindex(b"compression=lz4") - 400)
    path = tmp_path / "killed.bag"
    path.write_bytes(whole[:at] + bytes(8) + whole[at + 8 : last_chunk + 200])
    source = open_bag(path)
    assert "killed.bag was not finished when it was recorded" in source.health().message
    assert source.length == 2
    for index, frame in enumerate(source):
        np.testing.assert_array_equal(frame.proximity_depth, L515.depth.images[index])
        np.testing.assert_array_equal(frame.tactile_depth, D405.depth.images[index])
