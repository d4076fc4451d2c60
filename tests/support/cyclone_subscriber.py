"""A subscriber of Cyclone DDS.

`cyclone_subscriber.py DOMAIN PATCH_TOPIC POSE_TOPIC` prints one line of JSON with the first point cloud and the first
pose, as Cyclone DDS itself decodes them.
"""

import json
import sys
import time
from typing import Any

from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from ros_types import PointCloud2, PoseWithCovarianceStamped

# What ROS 2's Cyclone DDS gets with ROS_LOCALHOST_ONLY=1.
CONFIG = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces></General>
</Domain></CycloneDDS>"""


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
