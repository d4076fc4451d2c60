#!/bin/sh
# Runs the tests of the live cameras with the newest camera driver. The environment has the last one that knows the
# L515; the newest is put into a folder of its own, which comes first on the path.
set -eu
cd "$(dirname "$0")/.."
folder=$PWD/.realsense-newest
.venv/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --upgrade --target "$folder" \
    'pyrealsense2>=2.56.5,<2.60' || {
    echo "The newest camera driver could not be installed (pip's message is above): check the network." >&2
    [ -d "$folder/pyrealsense2" ] || exit 1
    echo "The one that is there is used instead." >&2
}
PYTHONPATH=$folder .venv/bin/python -c 'from importlib.metadata import version
import pyrealsense2
print("Camera driver", version("pyrealsense2"), "in", pyrealsense2.__path__[0])'
PYTHONPATH=$folder QT_QPA_PLATFORM=offscreen exec .venv/bin/python -m pytest tests/core/sources/realsense "$@"
