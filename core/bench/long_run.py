"""A long run of changes, to see whether a pipeline that remembers ever differs from one that starts afresh."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..contact.pipeline import ContactPatch, ContactPipeline
from ..model.frames import SensorFrame
from ..preset import Preset
from .stability import random_case

_NEW_RIG_EVERY = 500
_NEW_FRAME_SHARE = 0.4


@dataclass(frozen=True)
class LongRunReport:
    """How many steps were made and in how many the patch differed from a fresh pipeline's."""

    steps: int
    different: int

    def words(self) -> str:
        """Say it in one sentence."""
        return f"{self.steps:,} changes of parameters and frames: {self.different:,} patches unlike a fresh pipeline's"


def check_long_run(steps: int, seed: int = 0, progress: Callable[[float], None] = lambda share: None) -> LongRunReport:
    """Change a parameter, the frame or both at each step, on one pipeline and on a new one; compare bits."""
    random = np.random.default_rng(seed)
    different = 0
    for step in range(steps):
        if step % _NEW_RIG_EVERY == 0:
            preset, rig, frame = random_case(random, adversarial=False)
            preset = preset.with_value("outliers.enabled", True)
            kept = ContactPipeline(preset, rig)
            frames = [frame, *_variants(frame, random)]
            progress(step / steps)
        if random.random() < _NEW_FRAME_SHARE:
            frame = frames[int(random.integers(len(frames)))]
        else:
            preset = preset.with_values(_change(preset, random))
            kept.update(preset)
        different += not _same(kept.process(frame), ContactPipeline(preset, rig).process(frame))
    progress(1.0)
    return LongRunReport(steps, different)


def _variants(frame: SensorFrame, random: np.random.Generator) -> list[SensorFrame]:
    """Return frames with a little, much and no change of depth."""
    much = np.where(random.random(frame.tactile_depth.shape) < 0.2, 0, frame.tactile_depth).astype(np.uint16)
    little = frame.proximity_depth.copy()
    little[:, : little.shape[1] // 2] = np.clip(little[:, : little.shape[1] // 2], 1, 65534) - 1
    nothing = np.zeros_like(frame.proximity_depth)
    changed: tuple[dict[str, Any], ...] = (
        {"tactile_depth": much}, {"proximity_depth": little}, {"proximity_depth": nothing},
        {"proximity_color": frame.proximity_color[::-1]},
    )  # fmt: skip
    fields = {name: getattr(frame, name) for name in ("proximity_depth", "tactile_depth", "proximity_color")}
    return [SensorFrame(sequence=n + 1, **(fields | change)) for n, change in enumerate(changed)]


def _change(preset: Preset, random: np.random.Generator) -> dict[str, Any]:
    """Return one parameter's new value."""
    choices: dict[str, Callable[[], Any]] = {
        "tolerance.t": lambda: float(10 ** random.uniform(-3, -0.5)),
        "mask.enabled": lambda: not preset.mask.enabled,
        "mask.hue": lambda: tuple(int(value) for value in random.integers(0, 180, 2)),
        "outliers.enabled": lambda: not preset.outliers.enabled,
        "outliers.k": lambda: int(random.integers(1, 40)),
        "outliers.ratio": lambda: float(random.uniform(0.2, 4.0)),
        "outliers.min_cluster_area_mm2": lambda: float(random.choice((0.0, 50.0, 500.0))),
        "range.enabled": lambda: not preset.range.enabled,
        "region.enabled": lambda: not preset.region.enabled,
        "region.rectangle": lambda: (int(random.integers(40)), int(random.integers(30)), 50, 40),
        "alignment.model": lambda: str(random.choice(("rigid", "homography"))),
        "alignment.depth_offset_m": lambda: float(random.uniform(-0.01, 0.01)),
        "contact_test": lambda: str(random.choice(("tolerance", "membrane"))),
        "membrane.gap_m": lambda: float(random.uniform(0.0, 0.005)),
        "membrane.erosion": lambda: float(random.choice((0.0, 0.9, 2.0))),
        "membrane.balance": lambda: not preset.membrane.balance,
        "membrane.window_px": lambda: float(random.choice((0.0, 1.0, 2.5))),
    }
    name = str(random.choice(list(choices)))
    return {name: choices[name]()}


def _same(first: ContactPatch, second: ContactPatch) -> bool:
    return first.points.tobytes() == second.points.tobytes() and np.array_equal(first.provenance, second.provenance)
