"""Live ROS 2 messages, decoded by the decoder of MCAP."""

from __future__ import annotations

from typing import Any

import numpy as np
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from tactune.core.output.messages import definition


def decoded(kind: str, data: bytes) -> Any:
    decode = DecoderFactory().decoder_for("cdr", Schema(1, definition(kind).encode(), "ros2msg", kind))
    assert decode is not None
    return decode(data)


def points_of(cloud: Any, *values: str) -> np.ndarray[Any, Any]:
    """Return the points of a cloud, float32 (height, width, 3 + values), and check how it describes them."""
    names = "x", "y", "z", *values
    expected = [(name, 4 * place, 7, 1) for place, name in enumerate(names)]
    assert [(field.name, field.offset, field.datatype, field.count) for field in cloud.fields] == expected
    step = 4 * len(names)
    assert (cloud.point_step, cloud.row_step, cloud.is_bigendian) == (step, step * cloud.width, False)
    return np.frombuffer(bytes(cloud.data), "<f4").reshape(cloud.height, cloud.width, len(names))
