"""Measures the noise of both cameras, and the bias that prints tell, into the preset."""

from __future__ import annotations

from typing import Any

from ...core.model.frames import SensorFrame
from ...core.preset import RigNoise
from ...core.rig.noise import MIN_FRAMES, NOISE_FRAMES, describe, measure_noise
from ...core.sources.base import part_of
from ...widgets.basics.controls import push_button
from ..calibration.gather import Gather
from ..context import Context
from ..worker.jobs import Progress, Work
from ..worker.results import SourceInfo


class NoiseStep(Gather):
    """Measures at rest; the simulator takes its object away."""

    wanted, min_frames = NOISE_FRAMES, MIN_FRAMES

    def __init__(self, context: Context) -> None:
        tip = "Measure the noise of both cameras, and the bias on prints, into the preset; nothing may move"
        super().__init__(context, push_button("&Measure noise", tip))

    def work(self, kept: list[SensorFrame], info: SourceInfo) -> Work:
        count, preset, home = self.wanted, self._document.preset, self._document.untouched_home

        def measure(progress: Progress) -> RigNoise:
            untouched = info.find_untouched(preset, home, part_of(progress, 0, 2)).frame
            return measure_noise(kept[:count], info.rig, preset, untouched, part_of(progress, 1, 2))

        return measure

    def show_found(self, found: RigNoise) -> None:
        self.sentence.setText(" ".join(describe(found)))

    def changes(self) -> dict[str, Any]:
        return {"noise": self.found.model_dump()}
