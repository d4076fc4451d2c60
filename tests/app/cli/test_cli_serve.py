"""``tactune serve`` as a program, seen by a Foxglove client of another make."""

import json
import math
import re
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
import trimesh

from commands import read_line
from foxglove_client import WAIT_S, FoxgloveClient
from sockets import listening
from tactune.core import ContactPipeline, load_preset, open_source
from tactune.core.estimation.object_mesh import simulated_mesh
from tactune.core.estimation.pose import PoseTracker
from tactune.core.estimation.tilt import TiltEstimator
from tactune.core.output.connections import Connections
from tactune.core.output.publisher import LIVE_TOPICS, Publisher
from tactune.core.sources.simulator.scenes import resolve_scene

TACTUNE = Path(sys.executable).with_name("tactune")
SOURCE = "sim:cup"


@contextmanager
def serving(*words):
    """Start a server and yield it with its port, once it listens."""
    command = [str(TACTUNE), "serve", "--foxglove", "--source", SOURCE, *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            line = read_line(process.stdout)
            match = re.fullmatch(r"Foxglove: ws://127\.0\.0\.1:(\d+)\n", line)
            assert match, line
            yield process, int(match[1])
        finally:
            process.kill()


def find(number, preset):
    """Return a frame of the source that is served, and its patch."""
    with open_source(SOURCE) as source:
        assert source.length is not None
        source.seek(number % source.length)
        frame = source.next_frame()
        assert frame is not None
        return frame, ContactPipeline(preset, source.rig).process(frame)


@pytest.fixture
def mesh(tmp_path):
    """The mesh of the simulator's cup, in metres."""
    cup = simulated_mesh(resolve_scene("cup"), "cup")
    trimesh.Trimesh(cup.vertices_m, cup.triangles, process=False).export(tmp_path / "cup.ply")
    return tmp_path / "cup.ply"


def test_frames_go_on_while_the_object_is_searched_and_the_end_ends_the_search(mesh, monkeypatch, tactune):
    searches = []

    def search(tracker, patch, time_s, go_on):
        searches.append(patch.sequence)
        while True:
            go_on(0.5)
            time.sleep(0.01)

    monkeypatch.setattr(PoseTracker, "track", search)
    done = tactune("serve", "--foxglove", "--port", 0, "--source", SOURCE, "--mesh", mesh, "--unit", "m", "-n", 5)
    assert "published 5 frames" in done.out
    assert len(searches) == 1


def test_tilt_goes_to_foxglove_beside_ros_2_and_both_end_cleanly():
    options = ("--port", "0", "--estimate", "tilt", "--ros2", "--domain", "77", "--namespace", "left")
    with serving(*options) as (process, port), FoxgloveClient(port) as client:
        assert process.stdout is not None
        assert read_line(process.stdout) == "ROS 2: domain 77, 127.0.0.1, /left\n"
        sockets = listening(process.pid)
        assert {one for one in sockets if one[0].startswith("tcp")} == {("tcp", "127.0.0.1", port)}
        assert {one[0] for one in sockets} == {"tcp", "udp"}
        topics = ["/contact/tilt", "/tactune/frame"]
        client.subscribe(topics)
        seen = next(seen for seen in client.frames(topics) if not math.isnan(seen["/contact/tilt"].vector.x))
        process.send_signal(signal.SIGHUP)  # the terminal is closed
        out, err = process.communicate(timeout=WAIT_S)
        assert process.returncode == 0
        assert re.fullmatch(r"published \d+ frames? of live:sim:cup\n", out)
        assert "Traceback" not in err
    _, patch = find(json.loads(seen["/tactune/frame"].data)["sequence"], load_preset("simulator"))
    tilt = TiltEstimator(load_preset("simulator"), patch.rig).estimate(patch)
    assert (seen["/contact/tilt"].vector.x, seen["/contact/tilt"].vector.y) == (tilt.roll_rad, tilt.pitch_rad)


def test_other_computers_connect_only_where_asked(tactune, monkeypatch):
    places, put = [], Publisher.put
    monkeypatch.setattr(Publisher, "put", lambda *words: places.append(listening()) or put(*words))
    done = tactune("serve", "--foxglove", "--port", 0, "--host", "0.0.0.0", "--source", SOURCE, "--frames", 1)
    assert "other computers can connect and read everything, without a password" in done.err
    assert [(kind, address) for kind, address, _ in places[0]] == [("tcp", "0.0.0.0")]
    assert not Connections(host="::1").warning


def test_a_taken_port_is_told_before_the_source_opens(monkeypatch, tactune):
    opened = []
    monkeypatch.setattr("tactune.core.sources.registry.open_source", lambda *words: opened.append(words))
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert (
            f"port {port} (Address already in use"
            in tactune("serve", "--foxglove", "--port", port, "-s", "sim:cup").sentence
        )
    assert not opened


def test_the_layout_names_topics_that_exist(tmp_path, tactune):
    assert tactune("serve", "--layout", tmp_path / "tactune.json").status == 0
    text = (tmp_path / "tactune.json").read_text()
    topics = set(re.findall(r'"(/[a-z0-9_/]+)', text))
    assert len(topics) > 8
    assert topics <= set(LIVE_TOPICS)
    layout = json.loads(text)
    panels = re.findall(r'"(\w+!\w+)"', json.dumps(layout["layout"]))
    assert sorted(panels) == sorted(layout["configById"])
