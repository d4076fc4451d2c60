"""Plays recordings with librealsense, in a process of its own: ``librealsense_player.py PATH OUT.npz``.

The committed recordings in tests/data were made with librealsense's recorder and a software device of `images`.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

RATE_HZ = 30.0
START_S = 1_750_000_000.0


def images(camera: str, frame: int, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Depth (every count can occur) and colour of one frame; ``size`` is width and height."""
    width, height = size
    rng = np.random.default_rng([ord(camera[0]), frame])
    depth = rng.integers(0, 65536, (height, width), np.uint16)
    depth[0, :4] = 0, 1, 65534, 65535
    return depth, rng.integers(0, 256, (height, width, 3), np.uint8)


def played(path: Path, out: Path) -> dict[str, np.ndarray]:
    """Return what librealsense plays: images, stamps in ms, lenses, pose, unit."""
    subprocess.run([sys.executable, __file__, path, out], check=True, timeout=120)
    with np.load(out) as found:
        return dict(found)


def _play(path: str, out: str) -> None:
    import pyrealsense2 as rs

    device = rs.context().load_device(path)
    playback = device.as_playback()
    playback.set_real_time(False)
    got: dict[str, list[Any]] = {"Depth": [], "Color": []}
    stopped = []
    playback.set_status_changed_callback(lambda status: stopped.append(status == rs.playback_status.stopped))
    facts: dict[str, Any] = {}
    profiles = {}
    sensors = device.query_sensors()
    for sensor in sensors:
        for profile in sensor.get_stream_profiles():
            profiles[profile.stream_name()] = profile.as_video_stream_profile()
        if sensor.supports(rs.option.depth_units):
            facts["unit_m"] = sensor.get_option(rs.option.depth_units)
        sensor.open(sensor.get_stream_profiles())
    for sensor in sensors:
        sensor.start(lambda f: got[f.profile.stream_name()].append((f.timestamp, np.array(f.get_data()))))
    deadline = time.monotonic() + 100
    while not (stopped and stopped[-1]) and time.monotonic() < deadline:
        time.sleep(0.05)
    for name, profile in profiles.items():
        lens = profile.get_intrinsics()
        facts[f"{name}_lens"] = [lens.width, lens.height, lens.fx, lens.fy, lens.ppx, lens.ppy, *lens.coeffs]
        facts[f"{name}_model"] = str(lens.model).removeprefix("distortion.")
        facts[f"{name}_times_ms"] = [time_ms for time_ms, _ in got[name]]
        facts[name] = np.array([image for _, image in got[name]])
    pose = profiles["Depth"].get_extrinsics_to(profiles["Color"])
    facts["rotation"], facts["translation"] = pose.rotation, pose.translation
    np.savez(out, **facts)


if __name__ == "__main__":
    _play(*sys.argv[1:])
    os._exit(0)  # some versions hang or crash when they are taken down; the result is on disk
