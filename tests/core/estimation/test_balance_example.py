"""The example ``examples/balance_tray.py``: a robot program that levels a tray by the tilt of its contact patch."""

import math
import runpy
from pathlib import Path

EXAMPLE = Path(__file__).parents[3] / "examples" / "balance_tray.py"


def test_the_tray_is_level_soon_after_a_book(monkeypatch):
    example = runpy.run_path(str(EXAMPLE))
    monkeypatch.setitem(example["balance"].__globals__, "BOOKS", (example["Book"](0.3, 0.35, 0.040),))
    steps = example["balance"](2.0)
    assert max(abs(math.degrees(step.roll_rad)) for step in steps) > 2.0  # the book does roll the tray
    assert abs(math.degrees(steps[-1].sensor_rad)) > 2.0  # the sensor has turned below it
    (settled,) = example["settle_times"](steps)
    assert settled is not None and 0.0 < settled < 1.5
