"""Makes and plays recordings with librealsense, in a separate process.

As a script it needs numpy and any version of pyrealsense2 on PYTHONPATH:

    record_cameras.py record PATH l515|d405 [FRAMES WIDTHxHEIGHT START_S CLOCK COLOR_FORMAT]
    record_cameras.py play PATH OUT.npz

The committed fixtures in tests/data were made with pyrealsense2 2.58.4, 2.59.1 and 2.54.2:

    record_cameras.py record d405_2.58.4.db3 d405 3 48x32
    record_cameras.py record d405_2.59.1.db3 d405 3 48x32
    record_cameras.py record l515_2.54.2.bag l515 3 48x32
"""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

RATE_HZ = 30.0
START_S = 1_750_000_000.0
UNITS_M = {"l515": 0.00025, "d405": 0.0001}
MODELS = {"l515": "Intel RealSense L515", "d405": "Intel RealSense D405"}
SERIALS = {"l515": "f0000001", "d405": "130000000002"}
#: A quarter turn about z and a little shift, so that rows and columns cannot be confused.
COLOR_ROTATION, COLOR_TRANSLATION = [0, 1, 0, -1, 0, 0, 0, 0, 1], [0.015, -0.014, 0.003]


def images(camera: str, frame: int, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Depth (every count can occur) and colour of one frame; ``size`` is width and height."""
    width, height = size
    rng = np.random.default_rng([ord(camera[0]), frame])
    depth = rng.integers(0, 65536, (height, width), np.uint16)
    depth[0, :4] = 0, 1, 65534, 65535
    return depth, rng.integers(0, 256, (height, width, 3), np.uint8)


def lens_values(camera: str, kind: str, size: tuple[int, int]) -> dict[str, Any]:
    width, height = size
    focal = {"l515": 0.7203, "d405": 0.6779}[camera] * width * (1.31 if kind == "color" and camera == "l515" else 1)
    bent = kind == "color" and camera == "l515"
    return {
        "width": width,
        "height": height,
        "fx": focal,
        "fy": focal + 0.625,
        "ppx": width / 2 + 1.25,
        "ppy": height / 2 - 2.5,
        "model": "inverse_brown_conrady" if bent else "none",
        "coeffs": [0.125, -0.25, 0.001, -0.0005, 0.0625] if bent else [0.0] * 5,
    }


def record(
    path: str,
    camera: str,
    frames: int = 3,
    size: tuple[int, int] = (640, 480),
    start_s: float = START_S,
    clock: str = "global_time",
    color_format: str = "rgb8",
) -> None:
    """Have librealsense record a software device, paced in real time as the newer versions need."""
    import pyrealsense2 as rs

    device = rs.software_device()
    named = device.update_info if device.supports(rs.camera_info.name) else device.register_info
    named(rs.camera_info.name, MODELS[camera])
    device.register_info(rs.camera_info.serial_number, SERIALS[camera])
    depth_sensor = device.add_sensor("L500 Depth Sensor" if camera == "l515" else "Stereo Module")
    color_sensor = device.add_sensor("RGB Camera") if camera == "l515" else depth_sensor
    depth_sensor.add_read_only_option(rs.option.depth_units, UNITS_M[camera])
    bytes_per_pixel = {"rgb8": 3, "bgr8": 3, "rgba8": 4, "bgra8": 4, "yuyv": 2, "uyvy": 2, "y8": 1}[color_format]
    streams = [
        (depth_sensor, rs.stream.depth, rs.format.z16, 2, "depth"),
        (color_sensor, rs.stream.color, getattr(rs.format, color_format), bytes_per_pixel, "color"),
    ]
    profiles = []
    for number, (sensor, kind, pixel_format, width_bytes, name) in enumerate(streams):
        values = lens_values(camera, name, size)
        lens = rs.intrinsics()
        for key in ("width", "height", "fx", "fy", "ppx", "ppy", "coeffs"):
            setattr(lens, key, values[key])
        lens.model = getattr(rs.distortion, values["model"])
        stream = rs.video_stream()
        stream.type, stream.index, stream.uid, stream.fmt, stream.bpp = kind, 0, number, pixel_format, width_bytes
        stream.width, stream.height, stream.fps, stream.intrinsics = *size, int(RATE_HZ), lens
        profiles.append(sensor.add_video_stream(stream))
    pose = rs.extrinsics()
    pose.rotation, pose.translation = [1, 0, 0, 0, 1, 0, 0, 0, 1], [0, 0, 0]
    if camera == "l515":
        pose.rotation, pose.translation = COLOR_ROTATION, COLOR_TRANSLATION
    profiles[0].register_extrinsics_to(profiles[1], pose)

    recorder = rs.recorder(path, device)
    sensors = recorder.query_sensors()
    for sensor in sensors:
        sensor.open(sensor.get_stream_profiles())
        sensor.start(lambda _: None)
    alive = []
    begin_s = time.monotonic()
    for frame in range(frames):
        time.sleep(max(0.0, begin_s + frame / RATE_HZ - time.monotonic()))
        depth, color = images(camera, frame, size)
        for (sensor, _, _, width_bytes, name), profile in zip(streams, profiles, strict=True):
            image = depth if name == "depth" else stored_color(color, color_format)
            software = rs.software_video_frame()
            software.pixels = image
            software.bpp, software.stride = width_bytes, width_bytes * size[0]
            software.timestamp = (start_s + frame / RATE_HZ) * 1e3
            software.domain = getattr(rs.timestamp_domain, clock)
            software.frame_number = frame
            software.profile = profile.as_video_stream_profile()
            if name == "depth" and hasattr(software, "depth_units"):
                software.depth_units = UNITS_M[camera]
            sensor.on_video_frame(software)
            alive.append((software, image))
    time.sleep(0.5)
    for sensor in sensors:
        sensor.stop()
        sensor.close()
    # The file is finished when the last of these is gone.
    del alive, sensor, sensors, recorder, streams, depth_sensor, color_sensor, profiles, profile, device
    gc.collect()


def stored_color(color: np.ndarray, color_format: str) -> np.ndarray:
    """The bytes that a camera would send in this format; luma and chroma are taken from red and green."""
    if color_format in ("yuyv", "uyvy"):
        return np.ascontiguousarray(color[..., :2])
    if color_format == "y8":
        return np.ascontiguousarray(color[..., 0])
    order = [2, 1, 0] if color_format.startswith("bgr") else [0, 1, 2]
    stored = color[..., order]
    if "a" in color_format:
        stored = np.dstack([stored, np.full(color.shape[:2], 255, np.uint8)])
    return np.ascontiguousarray(stored)


def play(path: str, out: str) -> None:
    """Write what librealsense plays: images, stamps in ms, lenses, pose, unit."""
    import pyrealsense2 as rs

    device = rs.context().load_device(path)
    playback = device.as_playback()
    playback.set_real_time(False)
    got: dict[str, list[Any]] = {"Depth": [], "Color": []}

    def take(frame: Any) -> None:
        got[frame.profile.stream_name()].append((frame.timestamp, np.array(frame.get_data())))

    stopped = []
    playback.set_status_changed_callback(lambda status: stopped.append(status == rs.playback_status.stopped))
    facts: dict[str, Any] = {}
    profiles = {}
    sensors = device.query_sensors()
    for sensor in sensors:
        for profile in sensor.get_stream_profiles():
            profiles[profile.stream_name()] = profile.as_video_stream_profile()
        # Newer versions play the unit as an option only; a sensor that is read is no depth sensor there.
        if sensor.supports(rs.option.depth_units):
            facts["unit_m"] = sensor.get_option(rs.option.depth_units)
        sensor.open(sensor.get_stream_profiles())
    for sensor in sensors:
        sensor.start(take)
    deadline = time.monotonic() + 300
    while not (stopped and stopped[-1]) and time.monotonic() < deadline:
        time.sleep(0.05)
    for name, profile in profiles.items():
        lens = profile.get_intrinsics()
        facts[f"{name}_lens"] = [lens.width, lens.height, lens.fx, lens.fy, lens.ppx, lens.ppy, *lens.coeffs]
        facts[f"{name}_model"] = str(lens.model).removeprefix("distortion.")
        facts[f"{name}_times_ms"] = [time_ms for time_ms, _ in got[name]]
        facts[name] = np.array([image for _, image in got[name]])
    if len(profiles) == 2:
        pose = profiles["Depth"].get_extrinsics_to(profiles["Color"])
        facts["rotation"], facts["translation"] = pose.rotation, pose.translation
    np.savez(out, **facts)


def run(*arguments: object, driver: Path | None = None, timeout_s: float = 120.0) -> None:
    """Run this script in a process of its own, with the driver of this environment or of another folder."""
    environment = dict(os.environ)
    if driver is not None:
        environment["PYTHONPATH"] = str(driver)
    command = [sys.executable, __file__, *map(str, arguments)]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=timeout_s, check=False)
    if result.returncode:
        raise RuntimeError(f"{' '.join(command)}: {result.returncode}\n{result.stdout}{result.stderr}")


def _main() -> None:
    what, path, *rest = sys.argv[1:]
    if what == "play":
        play(path, rest[0])
        # Some versions hang or crash when they are taken down; the result is on disk.
        os._exit(0)
    camera, *rest = rest
    values: dict[str, Any] = {}
    parts = (("frames", int), ("size", _size), ("start_s", float), ("clock", str), ("color_format", str))
    for (name, convert), text in zip(parts, rest, strict=False):
        values[name] = convert(text)
    record(path, camera, **values)
    os._exit(0)


def _size(text: str) -> tuple[int, int]:
    width, height = text.split("x")
    return int(width), int(height)


if __name__ == "__main__":
    _main()
