"""Images and JSON of others: read or refused in our words; names of new files: taken by one of two programs."""

import json
import os
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from kinds import KINDS
from tactune.core.errors import ExportError
from tactune.core.model.loading import decode_image, parse_json

IMAGE = np.arange(6 * 8 * 3, dtype=np.uint8).reshape(6, 8, 3)
PNG = cv2.imencode(".png", IMAGE)[1].tobytes()
JPEG = cv2.imencode(".jpg", IMAGE)[1].tobytes()


def part(name, data):
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def with_part(name, data):
    """The picture with one more part behind its header, which ends at byte 33."""
    return PNG[:33] + part(name, data) + PNG[33:]


def with_header(bits, color):
    return PNG[:8] + part(b"IHDR", struct.pack(">IIBBBBB", 8, 6, bits, color, 0, 0, 0)) + PNG[33:]


def test_what_surrounds_the_pixels_of_a_png_is_left_out(capfd):
    assert np.array_equal(decode_image(with_part(b"iCCP", b"sRGB\0\0damaged")), IMAGE)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    "bad",
    [
        with_header(3, 2),
        with_header(8, 5),
        with_header(8, 3),
        with_part(b"IHDR", bytes(13)),
        PNG[:-30],
        JPEG[:-20],
        PNG[:60] + bytes([PNG[60] ^ 255]) + PNG[61:],
    ],
)
def test_a_damaged_image_is_refused_without_lines_of_libraries(bad, capfd):
    with pytest.raises(ValueError):
        decode_image(bad)
    assert capfd.readouterr().err == ""


def test_a_jpeg_may_be_padded():
    assert decode_image(JPEG + bytes(1000)).shape == IMAGE.shape


def test_a_large_json_is_checked_for_keys_that_stand_twice():
    """In one pass: a loop for each key would take hours."""
    text = json.dumps({f"key {number}": number for number in range(150_000)})
    assert len(parse_json(text)) == 150_000
    with pytest.raises(ValueError, match="the key 'key 0' stands twice"):
        parse_json(text[:-1] + ', "key 0": 1}')


WRITERS = {name: kind.new for name, kind in KINDS.items() if kind.new}


@pytest.mark.parametrize("links", [True, False])
@pytest.mark.parametrize("kind", WRITERS)
def test_a_name_that_another_program_takes_meanwhile_is_refused(kind, links, tmp_path, monkeypatch):
    """The second program writes its whole file at the moment when the first is about to name its own."""
    others = []

    def contents():
        return {str(file.relative_to(tmp_path)): file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}

    def after_the_other(name):
        def call(*words):
            if not others:
                others.append({})
                hidden = set(contents())
                WRITERS[kind](tmp_path, 1)
                others[0] = {file: data for file, data in contents().items() if file not in hidden}
            return name(*words)

        return call

    def no_links(*_):
        raise PermissionError

    monkeypatch.setattr(os, "link", after_the_other(os.link if links else no_links))
    monkeypatch.setattr(Path, "rename", after_the_other(Path.rename))
    with pytest.raises(ExportError, match=r"already there|not empty"):
        WRITERS[kind](tmp_path, 0)
    assert others[0]
    assert contents() == others[0]
