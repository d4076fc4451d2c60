"""A soak test of one minute with `support/soak.py`; up to three minutes if the memory slope is uncertain.

To check that memory grows by less than 1 MB per minute, run the script for 30 minutes.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[3] / "support" / "soak.py"


@pytest.mark.long
def test_a_minute_of_capturing_recording_and_showing_leaves_nothing_behind():
    done = subprocess.run(
        [sys.executable, SCRIPT, "--minutes", "1"],
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
        env=os.environ | {"QT_QPA_PLATFORM": "offscreen"},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.endswith("all is well\n")
