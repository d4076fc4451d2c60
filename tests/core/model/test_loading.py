"""Images and JSON of others: read or refused in our words, and no library writes to the terminal."""

import json
import struct
import time
import zlib

import cv2
import numpy as np
import pytest

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


@pytest.mark.parametrize("more", [(b"iCCP", b"sRGB\0\0damaged")])
def test_what_surrounds_the_pixels_of_a_png_is_left_out(more, capfd):
    assert np.array_equal(decode_image(with_part(*more)), IMAGE)
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


def test_a_large_json_is_checked_for_keys_that_stand_twice_in_one_pass():
    text = json.dumps({f"key {number}": number for number in range(150_000)})
    begun = time.process_time()
    assert len(parse_json(text)) == 150_000
    with pytest.raises(ValueError, match="the key 'key 0' stands twice"):
        parse_json(text[:-1] + ', "key 0": 1}')
    assert time.process_time() - begun < 30  # a loop for each key would take hours
