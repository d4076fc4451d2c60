"""The soak of `scripts/soak.py`, for a minute; where a busy machine leaves doubt about memory, for three.

Run it for 30 to see that memory stays flat to 1 MB per minute.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[4] / "scripts" / "soak.py"


@pytest.mark.long
def test_a_minute_of_capturing_recording_and_showing_leaves_nothing_behind() -> None:
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
