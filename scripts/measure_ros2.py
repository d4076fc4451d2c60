"""Measure what reading ROS 2 cameras costs: two of 848 x 480, depth and colour, published in another process.

.venv/bin/python scripts/measure_ros2.py [SECONDS]
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))

from ros2_cameras import cameras
from sockets import free_domain
from tactune.core.preset import CamerasSection
from tactune.core.sources.ros.live import open_topics


def thread_shares(before: dict[str, int], seconds: float) -> dict[str, float]:
    """Return the share of a core of each thread of this process, by its name."""
    ticks = os.sysconf("SC_CLK_TCK")
    return {name: (ticks_now - before.get(name, 0)) / ticks / seconds for name, ticks_now in thread_ticks().items()}


def thread_ticks() -> dict[str, int]:
    found = {}
    for task in Path("/proc/self/task").iterdir():
        name, _, rest = (task / "stat").read_text().partition("(")[2].rpartition(")")
        words = rest.split()
        found[f"{name} {task.name}"] = int(words[11]) + int(words[12])
    return found


def main() -> None:
    """Print the rate, and the share of a core in all and by thread."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 10.0
    domain = free_domain()
    with cameras(domain), open_topics(f"?domain={domain}", CamerasSection(), lambda share, words: None) as source:
        for _ in range(30):
            source.next_frame()
        lost, before, began_s, used_s = source.health(), thread_ticks(), time.monotonic(), time.process_time()
        count = 0
        while time.monotonic() - began_s < seconds:
            source.next_frame()
            count += 1
        passed_s, used_s = time.monotonic() - began_s, time.process_time() - used_s
        now = source.health()
        dropped = now.dropped - lost.dropped
        print(f"{count / passed_s:.1f} frames/s, {dropped} dropped, {100 * used_s / passed_s:.1f} % of a core")
        for name, share in sorted(thread_shares(before, passed_s).items(), key=lambda item: -item[1]):
            if share > 0.002:
                print(f"  {100 * share:4.1f} %  {name}")


if __name__ == "__main__":
    main()
