"""A small simulated rig before and after something happened to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, lru_cache
from pathlib import Path

from drifted import Drift, DriftedSimulator
from tactune.core.calibration.snapshots import take_snapshot
from tactune.core.model.frames import SensorFrame
from tactune.core.output.writer import SessionWriter
from tactune.core.sources.presets import load_preset
from tactune.core.sources.simulator.scenes import Variant

#: Frames of a still scene that go into the untouched frame; later ones have other noise.
AVERAGED = 15


@lru_cache(maxsize=16)
def drifted(drift: Drift | None = None, press: str = "none") -> DriftedSimulator:
    variant = Variant(press=press)
    return DriftedSimulator(drift or Drift(), scene="cup", variant=variant, cells=(60, 36))


@cache
def untouched() -> SensorFrame:
    rest = drifted()
    return take_snapshot([rest.read(index) for index in range(AVERAGED)]).frame


def record_looks(path: Path, sources: Sequence[DriftedSimulator]) -> None:
    """Write one frame of each source, ten seconds apart, with preset and untouched frame."""
    with SessionWriter(path, sources[0].rig, preset=load_preset("simulator"), untouched=untouched()) as writer:
        for number, source in enumerate(sources):
            time_s = 10.0 * number
            frame = source.read(AVERAGED + number)
            writer.put(
                replace(frame, sequence=number, proximity_time_s=time_s, tactile_time_s=time_s, truth=None), wait=True
            )
