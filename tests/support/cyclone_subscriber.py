"""A subscriber of Cyclone DDS with message types written by hand.

`cyclone_subscriber.py DOMAIN PATCH_TOPIC POSE_TOPIC` prints one line of JSON with the first point cloud and the first
pose, as Cyclone DDS itself decodes them.
"""

import json
import sys
import time
from dataclasses import dataclass
from typing import Any

from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float64, int32, sequence, uint8, uint32
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

# What ROS 2's Cyclone DDS gets with ROS_LOCALHOST_ONLY=1.
CONFIG = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces></General>
</Domain></CycloneDDS>"""


@dataclass
class Time(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    stamp: Time
    frame_id: str


@dataclass
class PointField(IdlStruct, typename="sensor_msgs.msg.dds_.PointField_"):
    name: str
    offset: uint32
    datatype: uint8
    count: uint32


@dataclass
class PointCloud2(IdlStruct, typename="sensor_msgs.msg.dds_.PointCloud2_"):
    header: Header
    height: uint32
    width: uint32
    fields: sequence[PointField]
    is_bigendian: bool
    point_step: uint32
    row_step: uint32
    data: sequence[uint8]
    is_dense: bool


@dataclass
class Point(IdlStruct, typename="geometry_msgs.msg.dds_.Point_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs.msg.dds_.Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Pose(IdlStruct, typename="geometry_msgs.msg.dds_.Pose_"):
    position: Point
    orientation: Quaternion


@dataclass
class PoseWithCovariance(IdlStruct, typename="geometry_msgs.msg.dds_.PoseWithCovariance_"):
    pose: Pose
    covariance: array[float64, 36]


@dataclass
class PoseWithCovarianceStamped(IdlStruct, typename="geometry_msgs.msg.dds_.PoseWithCovarianceStamped_"):
    header: Header
    pose: PoseWithCovariance


def main() -> None:
    number, patch_topic, pose_topic = int(sys.argv[1]), sys.argv[2], sys.argv[3]
    domain = Domain(number, CONFIG)
    participant = DomainParticipant(number)
    qos = Qos(Policy.Reliability.Reliable(max_blocking_time=0), Policy.History.KeepLast(1))
    clouds = DataReader(participant, Topic(participant, patch_topic, PointCloud2), qos=qos)
    poses = DataReader(participant, Topic(participant, pose_topic, PoseWithCovarianceStamped), qos=qos)
    cloud, pose = first(clouds), first(poses)
    position = pose.pose.pose.position
    seen = {
        "frame": cloud.header.frame_id,
        "fields": [field.name for field in cloud.fields],
        "width": cloud.width,
        "points": bytes(cloud.data).hex(),
        "position": [position.x, position.y, position.z],
        "covariance": list(pose.pose.covariance),
    }
    sys.stdout.write(json.dumps(seen) + "\n")
    del clouds, poses, participant, domain


def first(reader: DataReader[Any]) -> Any:
    """Return the first message of a topic; the test that waits for it has a limit."""
    while not (samples := reader.take(1)):
        time.sleep(0.01)
    return samples[0]


if __name__ == "__main__":
    main()
