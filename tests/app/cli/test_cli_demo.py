"""``tactune demo balance``: a tray is levelled in the simulator."""

from __future__ import annotations

import json

from tactune.core.evaluation import sensor_table


def test_balance_says_how_well_the_tray_is_levelled(tactune, monkeypatch):
    monkeypatch.setattr(sensor_table, "measured_rig", lambda preset, source: preset)
    finished = tactune("demo", "balance", "--seconds", 1)
    assert finished.status == 0
    assert finished.out.startswith("sim:tray, 30 frames; books: 350 g at 3 s")
    for words in ("P 5 1/s, D 0.1", "actuator at most 20 degrees/s, 50 ms late", "frames/s", "frame to angle"):
        assert words in finished.out
    assert "proximity alone has" in finished.out and "times the RMS error" in finished.out


def test_balance_as_json_with_other_gains_and_the_proximity_camera(tactune):
    words = ("--method", "proximity", "--sensor", "clean", "--p-gain", 0, "--d-gain", 0, "--seconds", 3.5, "--json")
    finished = tactune("demo", "balance", *words)
    found = json.loads(finished.out)
    assert found["method"] == "proximity" and found["gains"] == {"p_per_s": 0.0, "d": 0.0}
    assert found["frames"] == 105 and found["settle_s"] == [None]
    assert found["patch"]["rms_deg"] < 0.2 and found["latency_p95_ms"] > 0.0
