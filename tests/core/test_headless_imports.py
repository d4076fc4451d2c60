"""The core is headless, which `make lint` checks module by module: nothing loads what nobody has asked for."""

import subprocess
import sys

import pytest


@pytest.mark.parametrize(
    ("modules", "heavy"),
    [
        ("core.output.writer, tactune.core.sources.folder, tactune.core.sources.tactune_files", {"numba"}),
        ("core.contact.pipeline", {"scipy.spatial", "scipy.ndimage", "cv2", "open3d", "matplotlib"}),
        ("app.cli.main", {"numpy", "scipy", "cv2", "numba", "pydantic", "open3d", "PyQt6", "pyqtgraph"}),
        (
            "app.cli.lab, tactune.app.cli.run, tactune.app.cli.serve",
            {"PyQt6", "pyqtgraph", "open3d"},
        ),
        (
            "core.sources.capture.child",
            {"PyQt6", "pyqtgraph", "cv2", "numba", "scipy", "pyrealsense2", "rosbags", "open3d"},
        ),
    ],
    ids=["reading and recording", "the pipeline", "help", "commands without a window", "the capture process"],
)
def test_nothing_heavy_is_loaded_before_it_is_needed(modules, heavy):
    program = f"import sys, tactune.{modules}; print(sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", program], check=False, capture_output=True, text=True)
    assert done.stdout == "[]\n", done.stderr


def test_every_exported_name_is_there_without_window_or_extras():
    program = """
import sys
import tactune.core
print(all(getattr(tactune.core, name) is not None for name in tactune.core.__all__), len(tactune.core.__all__))
print(sorted({name.partition(".")[0] for name in sys.modules} & {"PyQt6", "OpenGL", "open3d", "optuna", "trimesh"}))
"""
    done = subprocess.run([sys.executable, "-c", program], check=False, capture_output=True, text=True)
    assert done.stdout.splitlines() == ["True 20", "[]"], done.stderr


def test_foxglove_needs_no_package_of_ros():
    program = """
import sys
sys.modules["cyclonedds"] = None  # as where it is not installed
from tactune.core.output.connections import Connections
from tactune.core.output.publisher import Publisher
with Publisher(Connections(foxglove=True, port=0).make_sinks()) as publisher:
    print(publisher.status()[0].sink.name)
try:
    Connections(ros2=True).make_sinks()
except Exception as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", program], check=False, capture_output=True, text=True)
    first, second = done.stdout.splitlines()
    assert first == "Foxglove" and "ROS 2 needs cyclonedds" in second


def test_a_plain_run_loads_and_unpacks_little():
    """What nobody asked for costs seconds at each start: metrics, recordings, calibration, the rest of the scene."""
    program = """
import sys
from tactune.app.cli.main import main
from tactune.core.sources.simulator import simulator_source
unpack, unpacked = simulator_source._PackedStates._next, []
simulator_source._PackedStates._next = lambda states: unpacked.append(1) or unpack(states)
sys.argv = ["tactune", "run", "--source", "sim", "--frames", "2"]
main()
heavy = ("scipy.spatial", "scipy.optimize", "scipy.special", "rosbags", "mcap", "PIL")
print([name for name in heavy if name in sys.modules], len(unpacked))
"""
    done = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == "[] 2"
