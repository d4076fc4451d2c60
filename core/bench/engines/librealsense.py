"""Alignment and deprojection by the camera driver, on a software device."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from ...contact.alignment import tactile_pose
from ...errors import TactuneError
from ...model.frames import DepthCamera
from ...model.intrinsics import Distortion
from ..registry import Job, Outcome, Runner, engine
from ..scenes import BenchScene

#: The first frameset may hold one image only.
_PAIRS = 8

_MODELS = {
    Distortion.NONE: "none",
    Distortion.BROWN_CONRADY: "brown_conrady",
    Distortion.INVERSE_BROWN_CONRADY: "inverse_brown_conrady",
    Distortion.MODIFIED_BROWN_CONRADY: "modified_brown_conrady",
}


@engine("librealsense-align", Job.ALIGN, "librealsense rs.align, depth warped", exact=False, needs=("pyrealsense2",))
def align(scene: BenchScene) -> Runner:
    """Warp the tactile depth into the proximity image, as the driver aligns depth to colour."""
    import pyrealsense2 as rs

    frameset, keep = _frameset(scene)
    block = rs.align(rs.stream.color)

    def run() -> Outcome:
        aligned = block.process(frameset).get_depth_frame()
        return Outcome(values=np.asanyarray(aligned.get_data()) * scene.rig.tactile.depth_unit_m)

    run.keep = keep  # type: ignore[attr-defined]
    return run


@engine("librealsense-pointcloud", Job.DEPROJECT, "librealsense rs.pointcloud", needs=("pyrealsense2",))
def deproject(scene: BenchScene) -> Runner:
    """Deproject the whole tactile depth image."""
    import pyrealsense2 as rs

    frameset, keep = _frameset(scene)
    block, depth = rs.pointcloud(), frameset.get_depth_frame()

    def run() -> Outcome:
        vertices = np.asanyarray(block.calculate(depth).get_vertices(2))
        return Outcome(points=vertices)

    run.keep = keep  # type: ignore[attr-defined]
    return run


def _frameset(scene: BenchScene) -> tuple[Any, Any]:
    """Return tactile depth and proximity colour as one frameset, and the objects that must outlive it.

    A live software frame has no depth unit in older drivers, so the pair goes through a recording.
    """
    import pyrealsense2 as rs

    with tempfile.TemporaryDirectory() as folder:
        file = str(Path(folder) / "pair.bag")
        _record(scene, file)
        context = rs.context()
        playback = context.load_device(file)
        playback.set_real_time(False)
        # the queue holds the whole recording: a driver that waits for a full queue can neither be stopped nor freed
        syncer = rs.syncer(2 * _PAIRS)
        sensors = playback.query_sensors()
        for sensor in sensors:
            sensor.open(sensor.get_stream_profiles())
            sensor.start(syncer)
        found = None
        for _ in range(_PAIRS):
            found = syncer.wait_for_frames(2000)
            if found.size() == 2:
                found.keep()
                break
        playback.pause()
        for sensor in sensors:  # not closed: the driver would free memory that its frames still use
            sensor.stop()
    if found is None or found.size() != 2:
        raise TactuneError("librealsense's software device gave no pair of frames; leave its engines out")
    return found, (context, playback, syncer, sensors)


def _record(scene: BenchScene, file: str) -> None:
    """Record a software device that sends the pair several times."""
    import pyrealsense2 as rs

    rig, frame = scene.rig, scene.frame
    device = rs.software_device()
    sensor = device.add_sensor("Stereo Module")
    sensor.add_read_only_option(rs.option.depth_units, rig.tactile.depth_unit_m)
    depth = sensor.add_video_stream(_stream(rs.stream.depth, 0, rig.tactile, rs.format.z16, 2))
    color = sensor.add_video_stream(_stream(rs.stream.color, 1, rig.proximity, rs.format.rgb8, 3))
    T_p_t = tactile_pose(scene.preset.alignment, rig)
    extrinsics = rs.extrinsics()
    extrinsics.rotation = T_p_t[:3, :3].T.ravel().tolist()
    extrinsics.translation = T_p_t[:3, 3].tolist()
    depth.register_extrinsics_to(color, extrinsics)
    recorder = rs.recorder(file, device)
    recorded = recorder.query_sensors()[0]
    recorded.open([depth, color])
    received = rs.frame_queue(1)
    recorded.start(received)
    image = np.zeros((*frame.proximity_depth.shape, 3), np.uint8)
    for number in range(1, _PAIRS + 1):
        for profile, data, size in ((depth, frame.tactile_depth, 2), (color, image, 3)):
            sent = rs.software_video_frame()
            sent.pixels, sent.stride, sent.bpp = np.array(data), data.shape[1] * size, size
            sent.timestamp, sent.domain = number * 33.3, rs.timestamp_domain.hardware_clock
            sent.frame_number, sent.profile = number, profile.as_video_stream_profile()
            if profile is depth and hasattr(sent, "depth_units"):
                sent.depth_units = rig.tactile.depth_unit_m
            sensor.on_video_frame(sent)
            time.sleep(0.005)
    recorded.stop()
    recorded.close()


def _stream(stream: Any, number: int, camera: DepthCamera, pixel_format: Any, bytes_per_pixel: int) -> Any:
    import pyrealsense2 as rs

    lens = camera.intrinsics
    intrinsics = rs.intrinsics()
    intrinsics.width, intrinsics.height = lens.width, lens.height
    intrinsics.fx, intrinsics.fy, intrinsics.ppx, intrinsics.ppy = lens.fx, lens.fy, lens.cx, lens.cy
    intrinsics.model = getattr(rs.distortion, _MODELS[lens.distortion])
    intrinsics.coeffs = list(lens.coefficients)
    made = rs.video_stream()
    made.type, made.index, made.uid = stream, 0, number
    made.width, made.height, made.fps = lens.width, lens.height, 30
    made.bpp, made.fmt, made.intrinsics = bytes_per_pixel, pixel_format, intrinsics
    return made
