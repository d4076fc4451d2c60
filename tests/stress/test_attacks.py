"""Small files that claim to be large, or that never end: a sentence within 10 s, and memory in proportion to the file.

Each attack is made from nothing, so the seeds are fixed. The limit of memory is 10 times the file plus 300 MB.
"""

import json
import struct
import zlib
from pathlib import Path

import lz4.frame
import pytest

from attacks import bounded
from tactune.core.calibration.rig_from_folder import fit_lens
from tactune.core.errors import TactuneError
from tactune.core.model.loading import decode_image
from tactune.core.sources.presets import load_preset
from tactune.core.sources.registry import open_source

pytestmark = pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="measures memory as Linux tells it")


def refused(read, path):
    """Read a file, which must give a sentence without line breaks."""
    size = sum(file.stat().st_size for file in path.rglob("*") if file.is_file()) if path.is_dir() else 0
    with bounded(size or (path.stat().st_size if path.is_file() else 0)), pytest.raises(TactuneError) as caught:
        read(path)
    assert "\n" not in str(caught.value)


def play(path):
    with open_source(str(path)) as source:
        list(source)


# Makers of files


def png(width, height, content=b"", bits=8, colour=2):
    def part(name, data):
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    head = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + part(b"IHDR", head) + part(b"IDAT", content) + part(b"IEND", b"")


def record(opcode, body):
    return struct.pack("<BQ", opcode, len(body)) + body


def chunk(content, size, packing=b"lz4"):
    return record(6, struct.pack("<QQQII", 0, 0, size, 0, 3) + packing + struct.pack("<Q", len(content)) + content)


def mcap_of_large_chunks(path):
    packed = lz4.frame.compress(bytes(2**28))
    path.write_bytes(b"\x89MCAP0\r\n" + 12 * chunk(packed, 2**28))


def folder(path, name, put):
    """A folder of one frame of which one file is replaced."""
    intrinsics = {"width": 8, "height": 6, "fx": 8.0, "fy": 8.0, "cx": 4.0, "cy": 3.0}
    camera = {"model": "x", "depth_unit_m": 0.001, **intrinsics}
    frame = path / "000000"
    frame.mkdir(parents=True)
    (path / "rig.json").write_text(json.dumps({"proximity": camera, "tactile": camera}))
    (frame / "frame.json").write_text(json.dumps({"sequence": 0, "proximity_time_s": 0.0, "tactile_time_s": 0.0}))
    grey = b"".join(b"\0" + bytes(16) for _ in range(6))
    for image in ("proximity_depth", "tactile_depth"):
        (frame / f"{image}.png").write_bytes(png(8, 6, zlib.compress(grey), bits=16, colour=0))
    rows = b"".join(b"\0" + bytes(24) for _ in range(6))
    (frame / "proximity_color.png").write_bytes(png(8, 6, zlib.compress(rows)))
    (frame / name).unlink(missing_ok=True)
    put(frame / name)


FILES = {
    "chunks.mcap": (mcap_of_large_chunks, play),
    "zeros.json": (lambda p: p.write_bytes(bytes(50_000_000)), load_preset),
}
IMAGES = {
    "claims gigapixels": lambda p: p.write_bytes(png(60_000, 60_000, zlib.compress(bytes(1000)))),
    "claims 2 gigapixels as JPEG": lambda p: p.write_bytes(b"\xff\xd8\xff\xc0\x00\x11\x08" + b"\xff" * 8 + bytes(99)),
}


@pytest.mark.long
@pytest.mark.parametrize("name", FILES)
def test_a_small_file_takes_little_memory_and_time(name, tmp_path):
    make, read = FILES[name]
    make(tmp_path / name)
    refused(read, tmp_path / name)


@pytest.mark.long
@pytest.mark.parametrize("kind", IMAGES)
@pytest.mark.parametrize("name", ["proximity_depth.png", "truth_contact.png"])
def test_a_folder_with_such_an_image_is_refused(name, kind, tmp_path):
    folder(tmp_path / "a", name, IMAGES[kind])
    refused(play, tmp_path / "a")


def test_a_picture_of_100_megapixels_is_refused_by_our_own_limit():
    with pytest.raises(ValueError, match="claims 10000 x 10000"):
        decode_image(png(10_000, 10_000))


@pytest.mark.long
def test_a_picture_that_claims_gigapixels_is_not_decoded(tmp_path):
    for n in range(20):
        (tmp_path / f"{n}.png").write_bytes(png(30_000, 30_000, zlib.compress(bytes(1000))))
    with bounded(0), pytest.raises(TactuneError):
        fit_lens(tmp_path, 9, 6, 0.02)
