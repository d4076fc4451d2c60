"""Live messages, decoded by MCAP's own ROS 2 decoder, and the mailboxes between frames and sinks."""

import threading
from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from ros_messages import decoded, points_of
from tactune.core.errors import PublishError
from tactune.core.estimation.tilt import Tilt
from tactune.core.model.clouds import deproject
from tactune.core.model.frames import Rig, SensorFrame, Shot
from tactune.core.model.patch import ContactPatch, Lazy, PressureFacts
from tactune.core.output.messages import pose_parts
from tactune.core.output.publisher import LIVE_TOPICS, Publisher, SinkStatus, frame_messages

WAIT_S = 60


TURN = ((0.0, -1.0, 0.0, 0.1), (1.0, 0.0, 0.0, 0.2), (0.0, 0.0, 1.0, 0.3), (0.0, 0.0, 0.0, 1.0))
FORCE = PressureFacts(
    *(Lazy(lambda: np.zeros((1, 1), np.float32)),) * 3,
    lambda pixels: np.zeros(len(pixels)),
    0.1,
    (100.0, 0.0, -2000.0),
    (1.0, 1.0, 20.0),
    1500.0,
    0.0,
    0.02,
    0.01,
    1.0,
    False,
    True,
    True,
)
TILT = Tilt(roll_rad=0.1, roll_sigma_rad=0.01, axis_rad=-0.5, axis_sigma_rad=0.05)


def test_every_topic_arrives_bit_for_bit(processed):
    frame, patch, preset = processed
    patch = copy(patch)
    patch.pressure = replace(FORCE, at_points=Lazy(lambda: np.ones(len(patch.points), np.float32)))
    covariance = np.arange(36, dtype=np.float64).reshape(6, 6)
    built = frame_messages(frame, patch, preset, 5 * 10**9, Lazy(TILT.record))
    found = [built.get(topic) for topic in built.parts]
    seen = {each.topic: decoded(LIVE_TOPICS[each.topic], each.data) for each in found if each is not None}
    seen |= {
        topic: decoded(LIVE_TOPICS[topic], data)
        for topic, data in pose_parts(np.array(TURN), covariance, built.stamp_ns).items()
    }
    assert seen.keys() == LIVE_TOPICS.keys()

    force, torque = seen["/contact/wrench"].wrench.force, seen["/contact/wrench"].wrench.torque
    assert (force.x, force.y, force.z) == pytest.approx((0.15, 0.0, -3.0))
    centre = patch.points.mean(axis=0, dtype=np.float64)
    assert (torque.x, torque.y, torque.z) == pytest.approx(np.cross(centre, (0.15, 0.0, -3.0)), abs=1e-6)
    assert seen["/contact/relative_force_mm2"].vector.z == -2000.0
    arrow = seen["/contact/force_arrow"]
    start, end = ((each.x, each.y, each.z) for each in arrow.points)
    assert (arrow.type, arrow.action) == (0, 0)
    assert start == pytest.approx(tuple(centre), abs=1e-6)
    assert np.cross(np.subtract(end, start), (100.0, 0.0, -2000.0)) == pytest.approx(0.0, abs=1e-9)
    assert len(patch.points) > 1000
    expected = np.column_stack([patch.points, np.tile(np.float32([1.0, 1500.0]), (len(patch.points), 1))])
    assert np.array_equal(points_of(seen["/contact/patch"], "relative_pressure", "pressure_pa")[0], expected)
    assert seen["/contact/area_mm2"].data == patch.area_mm2
    for name, camera in (("proximity", patch.rig.proximity), ("tactile", patch.rig.tactile)):
        counts = getattr(frame, f"{name}_depth")
        cloud = points_of(seen[f"/{name}/points"])
        known = np.flatnonzero((counts != 0) & (counts != 65535))
        assert cloud.shape == (*counts.shape, 3)
        assert np.array_equal(cloud.reshape(-1, 3)[known], deproject(counts, camera, known))
        assert np.isnan(cloud).all(axis=-1).sum() == counts.size - len(known)
        assert seen[f"/{name}/points"].is_dense is False
        image = seen[f"/{name}/depth/image"]
        assert (image.encoding, image.step) == ("16UC1", 2 * counts.shape[1])
        assert bytes(image.data) == counts.tobytes()
        assert bytes(seen[f"/{name}/color/image"].data) == getattr(frame, f"{name}_color").tobytes()
        lens = seen[f"/{name}/depth/camera_info"]
        assert lens.header.frame_id == image.header.frame_id == seen[f"/{name}/points"].header.frame_id
        assert lens.k[0] == camera.intrinsics.fx
    stamp = seen["/contact/patch"].header.stamp
    assert stamp.sec * 10**9 + stamp.nanosec == round(frame.proximity_time_s * 1e9) + 5 * 10**9

    pose = seen["/object/pose"].pose
    assert (pose.pose.position.x, pose.pose.position.y, pose.pose.position.z) == (0.1, 0.2, 0.3)
    assert np.allclose((pose.pose.orientation.z, pose.pose.orientation.w), np.sqrt(0.5))
    assert np.array_equal(pose.covariance, covariance.ravel())
    moving, static = seen["/tf"].transforms, seen["/tf_static"].transforms
    assert [(t.header.frame_id, t.child_frame_id) for t in moving] == [("proximity_depth_optical_frame", "object")]
    assert "tactile_depth_optical_frame" in [t.child_frame_id for t in static]
    for topic, angles in (("/contact/tilt", [0.1, np.nan, -0.5]), ("/contact/tilt_sigma", [0.01, np.nan, 0.05])):
        vector = seen[topic].vector
        assert np.array_equal([vector.x, vector.y, vector.z], angles, equal_nan=True)
    values = {pair.key: pair.value for pair in seen["/diagnostics"].status[0].values}
    assert float(values["total ms"]) == pytest.approx(sum(patch.stage_ms.values()), abs=0.01)


class Collecting:
    """A sink that keeps messages; it can be told to wait before it sends, or to fail."""

    def __init__(self, wanted):
        self.topics, self.announced = wanted, {}
        self.messages = []
        self.gate = threading.Event()
        self.gate.set()
        self.entered = threading.Event()
        self.fault = None
        self.arrived = threading.Condition()
        self.is_open = False

    def start(self):
        self.is_open = True

    def announce(self, topics):
        self.announced |= topics

    def wanted(self):
        return self.topics

    def send(self, messages):
        self.entered.set()
        assert self.gate.wait(WAIT_S)
        if self.fault is not None:
            raise self.fault
        with self.arrived:
            self.messages += messages
            self.arrived.notify_all()

    def close(self):
        self.is_open = False

    def status(self):
        return SinkStatus("collecting", "here", 1)

    def wait_for(self, is_done):
        with self.arrived:
            assert self.arrived.wait_for(lambda: is_done(self.messages), WAIT_S)


def test_a_slow_sink_loses_its_own_frames_and_no_other(processed):
    quick, slow = Collecting(["/contact/area_mm2"]), Collecting(["/contact/area_mm2"])
    slow.gate.clear()
    with Publisher([quick, slow]) as publisher:
        for count in range(1, 6):
            publisher.put(*processed)
            assert slow.entered.wait(WAIT_S)
            quick.wait_for(lambda messages, count=count: len(messages) == count)
        assert not slow.messages
        slow.gate.set()
        slow.wait_for(lambda messages: len(messages) == 2)
        of_quick, of_slow = publisher.status()
        assert of_quick.missed == 0
        assert of_slow.missed == 3
    assert not quick.is_open
    assert not slow.is_open
    assert quick.messages[0].data is slow.messages[0].data  # nothing is encoded twice


def test_a_pose_that_comes_later_has_the_stamp_of_its_frame(processed):
    frame, patch, preset = processed
    later = replace(frame, proximity_time_s=frame.proximity_time_s + 0.5)
    sink = Collecting(["/object/pose", "/contact/area_mm2", "/tf_static"])
    with Publisher([sink]) as publisher:
        publisher.put_pose(np.eye(4), np.eye(6), frame.proximity_time_s)  # of a frame that nobody saw
        for count, each in enumerate((frame, later), start=1):
            publisher.put(each, patch, preset)
            sink.wait_for(lambda messages, count=count: len(messages) == count + 1)
        publisher.put_pose(np.array(TURN), np.eye(6), frame.proximity_time_s)
        sink.wait_for(lambda messages: len(messages) == 4)
    [pose] = [message for message in sink.messages if message.topic == "/object/pose"]
    assert pose.stamp_ns == sink.messages[0].stamp_ns
    assert decoded(LIVE_TOPICS[pose.topic], pose.data).pose.pose.position.y == 0.2


def test_a_topic_is_announced_once_a_frame_has_it(processed):
    frame, patch, preset = processed
    rig = Rig.of_one_camera(patch.rig.tactile)
    alone = SensorFrame.of_shots(rig, 0, None, Shot(frame.tactile_depth, frame.tactile_color, 0.0))
    of_one = ContactPatch(0, np.empty((0, 3), np.float32), patch.provenance, patch.aligned, rig, {})
    sink = Collecting(["/tactile/points"])
    with Publisher([sink]) as publisher:
        publisher.put(alone, of_one, preset)
        sink.wait_for(lambda messages: len(messages) == 1)
        assert "/tactile/depth/image" in sink.announced
        assert not [topic for topic in sink.announced if "proximity" in topic or "tilt" in topic or "object" in topic]
        publisher.put(*processed, Lazy(TILT.record))
        sink.wait_for(lambda messages: len(messages) == 2)
        publisher.put_pose(np.eye(4), np.eye(6), frame.proximity_time_s)
        publisher.put(*processed)
        sink.wait_for(lambda messages: len(messages) == 3)
    assert sink.announced == LIVE_TOPICS


def test_a_sink_that_cannot_start_closes_the_others():
    first, second = Collecting([]), Collecting([])

    def refuse():
        raise PublishError("port 8765 is taken")

    second.start = refuse
    with pytest.raises(PublishError, match="8765"):
        Publisher([first, second])
    assert not first.is_open
