"""Measure what ROS 2 topics cost and how late they come: a frame of 640 x 480 pixels, 30 times a second, to Fast DDS.

The subscriber is ROS 2's default middleware in a process of its own, on this computer, with default settings. For each
choice of topics: the share of messages that came, the time from `Publisher.put` to the end of the subscriber's pipe,
and the processor time of this process, which encodes, sends and reads that pipe, but finds no patches::

    python scripts/measure_dds.py --seconds 10
"""

from __future__ import annotations

import argparse
import os
import struct
import sys
import tempfile
import time
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))

from fast_dds import HOW_TO_BUILD, FastDds, build, can_build
from sockets import free_domain
from tactune.core import ContactPipeline, load_preset, open_source
from tactune.core.output.dds import DdsSink
from tactune.core.output.publisher import LIVE_TOPICS, Publisher

RATE_HZ = 30.0
CHOICES = {
    "patch": ["/contact/patch"],
    "one cloud": ["/proximity/points"],
    "both clouds, all images": [topic for topic in LIVE_TOPICS if topic.endswith(("/points", "/image", "/patch"))],
}


def measure(program: Path, topics: list[str], seconds: float, qos: str) -> str:
    """Publish for some seconds and return a line."""
    with open_source("sim:cup") as source:
        source.seek(40)
        frame, preset = source.next_frame(), load_preset("simulator")
        assert frame is not None
        patch = ContactPipeline(preset, source.rig).process(frame)
    late_ms: defaultdict[str, list[float]] = defaultdict(list)
    sizes: dict[str, int] = {}

    def note(topic: str, data: bytes) -> None:
        sec, nanosec = struct.unpack_from("<iI", data, 4)
        late_ms[topic].append(1e-6 * (time.time_ns() - sec * 10**9 - nanosec))
        sizes[topic] = len(data)

    domain = free_domain()
    with (
        Publisher([DdsSink(domain)]) as publisher,
        FastDds(program, domain, dict.fromkeys(topics, qos), "", note) as clients,
    ):
        while not all(clients.counts.values()):
            publisher.put(replace(frame, proximity_time_s=time.time(), tactile_time_s=time.time()), patch, preset)
            time.sleep(0.1)
        late_ms.clear()
        count, processor_s, end_s = 0, time.process_time(), time.monotonic() + seconds
        while time.monotonic() < end_s:
            began_s = time.monotonic()
            publisher.put(replace(frame, proximity_time_s=time.time(), tactile_time_s=time.time()), patch, preset)
            count += 1
            time.sleep(max(0.0, 1 / RATE_HZ - (time.monotonic() - began_s)))
        processor_s = time.process_time() - processor_s
    came = sum(map(len, late_ms.values()))
    late = np.concatenate(list(late_ms.values()))
    size_mb, share = sum(sizes.values()) / 1e6, 100 * came / count / len(topics)
    return (
        f"{qos:11s} {size_mb:5.1f} MB/frame  {share:4.0f} % came  {np.median(late):6.1f} ms median  "
        f"{np.percentile(late, 95):6.1f} ms 95 %  {100 * processor_s / seconds:4.0f} % of a core"
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0, help="for each line")
    options = parser.parse_args()
    if not can_build():
        parser.exit(2, f"Fast DDS is missing: {HOW_TO_BUILD}\n")
    with tempfile.TemporaryDirectory() as folder:
        program = build(Path(folder))
        for name, topics in CHOICES.items():
            for qos in ("reliable", "best_effort"):
                print(f"{name:24s} {measure(program, topics, options.seconds, qos)}", flush=True)
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
