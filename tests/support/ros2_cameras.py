"""Two depth cameras as ROS 2 drivers publish them, in a process of their own: 848 x 480, depth and colour, 30 Hz.

ros2_cameras.py DOMAIN RATE LENS_MODEL CAMERA...; it ends when standard input closes.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from select import select
from typing import Any

import numpy as np

from commands import read_line
from tactune.core.sources.ros.dds import Participant
from tactune.core.sources.ros.messages import CAMERA_INFO, IMAGE, TRANSFORMS, TYPES

WIDTH, HEIGHT = 848, 480
CAMERAS = ("l515", "d405")
#: Position of the second camera in the frame of the first, through the chain of both links.
BASELINE_M = 0.25
DEPTH = np.random.default_rng(0).integers(200, 400, (HEIGHT, WIDTH)).astype(np.uint16)
COLOR = np.random.default_rng(1).integers(0, 255, (HEIGHT, WIDTH, 3)).astype(np.uint8)


def message(name: str, **fields: Any) -> Any:
    return TYPES.types[name](**fields)


def cdr(value: Any, kind: str) -> bytes:
    return bytes(TYPES.serialize_cdr(value, kind))


def header(stamp_ns: int, frame: str) -> Any:
    stamp = message("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return message("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def image(stamp_ns: int, frame: str, encoding: str, pixels: Any) -> bytes:
    rows = pixels.reshape(len(pixels), -1).view(np.uint8)
    value = message(
        IMAGE, header=header(stamp_ns, frame), height=len(pixels), width=pixels.shape[1], encoding=encoding,
        is_bigendian=0, step=rows.shape[1], data=rows.reshape(-1),
    )  # fmt: skip
    return cdr(value, IMAGE)


def camera_info(stamp_ns: int, frame: str, model: str) -> bytes:
    k = np.array([600.0, 0, WIDTH / 2, 0, 600.0, HEIGHT / 2, 0, 0, 1])
    roi = message("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    value = message(
        CAMERA_INFO, header=header(stamp_ns, frame), height=HEIGHT, width=WIDTH, distortion_model=model,
        d=np.full(5, 0.0 if model == "none" else 0.001), k=k,
        r=np.eye(3).ravel(), p=np.zeros(12), binning_x=0, binning_y=0, roi=roi,
    )  # fmt: skip
    return cdr(value, CAMERA_INFO)


def transforms() -> bytes:
    """A chain: the rig holds both links, each link its optical frame."""

    def fixed(parent: str, child: str, x: float) -> Any:
        translation = message("geometry_msgs/msg/Vector3", x=x, y=0.0, z=0.0)
        rotation = message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
        pose = message("geometry_msgs/msg/Transform", translation=translation, rotation=rotation)
        name = "geometry_msgs/msg/TransformStamped"
        return message(name, header=header(0, parent), child_frame_id=child, transform=pose)

    links = [fixed("rig", f"{name}_link", n * BASELINE_M) for n, name in enumerate(CAMERAS)]
    optical = [fixed(f"{name}_link", f"{name}_optical", 0.0) for name in CAMERAS]
    return cdr(message(TRANSFORMS, transforms=[*links, *optical]), TRANSFORMS)


def topics_of(names: Sequence[str]) -> dict[str, str]:
    """Topics and types, as realsense-ros names them."""
    streams = {"depth/image_rect_raw": IMAGE, "depth/camera_info": CAMERA_INFO}
    streams |= {"color/image_raw": IMAGE, "color/camera_info": CAMERA_INFO}
    return {f"/{name}/{what}": kind for name in names for what, kind in streams.items()} | {"/tf_static": TRANSFORMS}


def messages(number: int, stamp_ns: int, names: Sequence[str], model: str = "plumb_bob") -> Iterator[tuple[str, bytes]]:
    """Topics and messages of one moment; the first pixel of depth and colour is the number."""
    for name in names:
        frame = f"{name}_optical"
        DEPTH[0, 0], COLOR[0, 0] = number, number % 256
        yield f"/{name}/depth/image_rect_raw", image(stamp_ns, frame, "16UC1", DEPTH)
        yield f"/{name}/color/image_raw", image(stamp_ns, frame, "rgb8", COLOR)
        for what in ("depth", "color"):
            yield f"/{name}/{what}/camera_info", camera_info(stamp_ns, frame, model)


def publish(domain: int, rate_hz: float, model: str, names: list[str]) -> None:
    participant = Participant(domain, "127.0.0.1")
    writers = {
        topic: participant.write(topic, kind, TYPES.hash_rihs01(kind), 4, topic == "/tf_static")
        for topic, kind in topics_of(names).items()
    }
    writers["/tf_static"].send(transforms())
    sys.stdout.write("published\n")
    sys.stdout.flush()
    number, began_s = 0, time.time()
    while not select([sys.stdin], [], [], max(0.0, began_s + number / rate_hz - time.time()))[0]:
        for topic, data in messages(number, round((began_s + number / rate_hz) * 1e9), names, model):
            writers[topic].send(data)
        number += 1
    participant.close()


@contextmanager
def cameras(
    domain: int, rate_hz: float = 30.0, names: Sequence[str] = CAMERAS, model: str = "plumb_bob"
) -> Iterator[subprocess.Popen[bytes]]:
    """Publish until the end of the context, which begins when the first topics are there."""
    words = [sys.executable, __file__, str(domain), str(rate_hz), model, *names]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            read_line(process.stdout)
            yield process
        finally:
            if process.stdin is not None:
                process.stdin.close()
            process.wait(60)


if __name__ == "__main__":
    publish(int(sys.argv[1]), float(sys.argv[2]), sys.argv[3], sys.argv[4:])
