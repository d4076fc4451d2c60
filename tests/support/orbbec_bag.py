"""Recordings of the Orbbec SDK, written without a camera: a Femto Bolt with depth and colour."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer

Pixels = np.ndarray[Any, Any]

RATE_HZ = 30
#: Version of the file's format, of the SDK 2.9.
FORMAT = 2.1
DEPTH_LENS = (504.0, 505.0, 317.5, 289.5)
COLOR_LENS = (600.0, 601.0, 330.0, 240.0)
#: Position of the depth camera in the colour camera's frame, millimetres.
SHIFT_MM = (-32.0, -2.0, 4.0)
_COLOR, _DEPTH = 2, 3  # numbers of sensor, stream and frame
_RGB, _Y16 = 22, 8  # formats
_VENDOR, _FEMTO_BOLT = 0x2BC5, 0x066B


def _string(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode()


def _header(time_ns: int) -> bytes:
    return struct.pack("<III", 0, time_ns // 10**9, time_ns % 10**9) + _string("")


def _blob(data: bytes) -> bytes:
    return struct.pack("<I", len(data)) + data


def _image(time_ns: int, number: int, encoding: str, pixels: Pixels) -> bytes:
    height, width = pixels.shape[:2]
    us = time_ns // 1000
    return (
        _header(time_ns) + struct.pack("<II", height, width) + _string(encoding)
        + struct.pack("<BI", 0, pixels.nbytes // height) + _blob(pixels.tobytes())
        + struct.pack("<fQQQQ", 0.0, number, us, us, us) + _blob(b"") + struct.pack("<IB", 0, 8 * pixels.itemsize)
    )  # fmt: skip


def _profile(
    time_ns: int, stream: int, form: int, shape: tuple[int, ...], lens: tuple[float, ...], k1: float, model: int
) -> bytes:
    height, width = shape[:2]
    return (
        _header(time_ns) + struct.pack("<BB", stream, form) + struct.pack("<9f", *np.eye(3).ravel())
        + struct.pack("<3f", *SHIFT_MM) + struct.pack("<HHH", width, height, RATE_HZ) + struct.pack("<4f", *lens)
        + struct.pack("<8f", k1, *[0.0] * 7) + struct.pack("<B", model)
    )  # fmt: skip


def write_bag(
    path: Path, depths: Sequence[Pixels], colors: Sequence[Pixels], serial: str, model: int = 0, k1: float = 0.0
) -> None:
    """Write images as the SDK's RecordDevice does; ``model`` and ``k1`` are of the colour lens."""
    began_ns = 1_700_000_000 * 10**9
    with Writer(path) as bag:

        def topic(name: str, kind: str, md5: str = "0123456789abcdef0123456789abcdef") -> Any:
            return bag.add_connection(f"/cam/{name}", kind, msgdef="", md5sum=md5)

        version = struct.pack("<I", 0) + _blob(struct.pack("<d", FORMAT)) + struct.pack("<I", 8)
        bag.write(topic("property", "custom_msg/msg/OBProperty"), began_ns, _header(began_ns) + version)
        image_md5 = "060021388200f6f0f447d0fcd9c64743"
        images = {n: topic(f"sensor_{n}/frameType_{n}", "sensor_msgs/msg/Image", image_md5) for n in (_DEPTH, _COLOR)}
        for number, (depth, color) in enumerate(zip(depths, colors, strict=True)):
            time_ns = began_ns + number * 10**9 // RATE_HZ
            bag.write(images[_DEPTH], time_ns, _image(time_ns, number, "mono16", depth))
            bag.write(images[_COLOR], time_ns, _image(time_ns, number, "rgb8", color))
        device = b"".join(map(_string, ["Femto Bolt", "Orbbec Femto Bolt", "Mars02"]))
        device += struct.pack("<HH", _VENDOR, _FEMTO_BOLT)
        device += b"".join(map(_string, ["2-1", serial, "1.1.2", "1.0", "2.0.0", "USB3.0"]))
        device += struct.pack("<HB", 0, 0) + _string("") + _string("")
        about = topic("deviceInfo", "custom_msg/msg/OBDeviceInfo", "afef5328bb4abebd1a309e1ea8b26b3a")
        bag.write(about, began_ns, _header(began_ns) + device)
        for stream, form, shape, lens, bend, kind in (
            (_DEPTH, _Y16, depths[0].shape, DEPTH_LENS, 0.0, 0),
            (_COLOR, _RGB, colors[0].shape, COLOR_LENS, k1, model),
        ):
            profile = topic(f"streamProfileType_{stream}", "custom_msg/msg/OBStreamProfileInfo")
            bag.write(profile, began_ns, _profile(began_ns, stream, form, shape, lens, bend, kind))
