"""The programs of docs/guide/robot.md, run as they stand: against the simulator and against ``tactune serve``.

ROS 2's client library cannot be installed here. `tests/support/rclpy_stand_in` stands in for it, by Cyclone DDS. It
shows that topics, types and fields of the program are right, not that rclpy accepts it.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from commands import read_line
from sockets import free_domain

ROOT = Path(__file__).resolve().parents[2]
SUPPORT = ROOT / "tests" / "support"
GUIDE = ROOT / "docs" / "guide" / "robot.md"
TACTUNE = Path(sys.executable).with_name("tactune")


@pytest.fixture(scope="module")
def programs() -> list[str]:
    found: list[str] = re.findall(r"```python\n(.*?)```", GUIDE.read_text(), re.DOTALL)
    assert len(found) == 3
    return found


@contextmanager
def running(program: str, **environment: str) -> Iterator[Iterator[str]]:
    """Run a program and yield the lines that it prints."""
    assert sum(bool(line.strip()) for line in program.splitlines()) <= 25
    command = [sys.executable, "-c", program]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=os.environ | environment) as process:
        assert process.stdout is not None
        try:
            yield iter(lambda: read_line(process.stdout), "")
        finally:
            process.kill()


@pytest.fixture(scope="module")
def domain() -> int:
    return free_domain()


@pytest.fixture(scope="module")
def served(domain: int) -> Iterator[str]:
    """Serve the simulator for ROS 2 and Foxglove; return the address of the latter."""
    command = [TACTUNE, "serve", "--ros2", "--foxglove", "--port", "0", "--source", "sim:cup"]
    environment = os.environ | {"ROS_DOMAIN_ID": str(domain)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        assert process.stdout is not None
        try:
            places = dict(read_line(process.stdout).split(": ", 1) for _ in range(2))
            assert places["ROS 2"] == f"domain {domain}, 127.0.0.1, /tactune\n"
            yield places["Foxglove"].strip()
        finally:
            process.kill()


def test_the_python_program_levels_a_tray(programs: list[str]) -> None:
    with running(programs[0]) as lines:
        rates = [float(re.fullmatch(r"turn ([+-][\d.]+) rad/s\n", line)[1]) for line in lines]  # type: ignore[index]
    assert any(rates[:-1])
    assert rates[-1] == 0.0, "it stops where the source ends"


def test_the_ros_program_follows_an_object(programs: list[str], served: str, domain: int) -> None:
    paths = os.pathsep.join((str(SUPPORT / "rclpy_stand_in"), str(SUPPORT)))
    with running(programs[1], PYTHONPATH=paths, ROS_DOMAIN_ID=str(domain)) as lines:
        for line in lines:
            match = re.fullmatch(r"move ([+-][\d.]+) ([+-][\d.]+) m\n", line)
            assert match, line
            if any(float(word) for word in match.groups()):
                return
    pytest.fail("the program ended")


def test_the_websocket_program_closes_a_gripper(programs: list[str], served: str) -> None:
    assert "ws://127.0.0.1:8765" in programs[2]
    seen = set()
    with running(programs[2].replace("ws://127.0.0.1:8765", served)) as lines:
        for line in lines:
            match = re.fullmatch(r"close ([+-][\d.]+) mm/s\n", line)
            assert match, line
            seen.add(float(match[1]))
            if seen >= {4.0} and min(seen) < 4.0:  # without contact, and with some
                return
    pytest.fail("the program ended")
