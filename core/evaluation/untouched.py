"""What methods compare with: the inflated membrane that nothing touches."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final
from urllib.parse import parse_qsl

from ..calibration.snapshots import take_snapshot
from ..frames import SensorFrame
from ..sources.base import FrameSource, Progress
from ..sources.simulator.cache import SolvedScene
from ..sources.simulator.scenes import Scene, Variant
from ..sources.simulator.source import SimulatorSource

#: Frames whose median is the reference, as a person would capture it.
REFERENCE_FRAMES: Final = 15

_AWAY_M: Final = 0.060
#: No frame of the reference has the noise of a frame that is judged.
_OTHER_SEEDS: Final = 1_000_000


def untouched_frame(source: FrameSource, progress: Progress | None = None) -> SensorFrame | None:
    """Return a frame of the untouched membrane, or None where the source has none.

    It is what the source keeps as its reference. The simulator's is measured, too, never its truth: the
    median of `REFERENCE_FRAMES` noisy frames of the same membrane with its object far away.

    Raises
    ------
    SourceError
        The source's reference cannot be read.
    """
    reference = source.reference()
    if reference is not None or not isinstance(source, SimulatorSource):
        return reference
    with _Untouched(source, progress) as away:
        return take_snapshot(away.read(index) for index in range(REFERENCE_FRAMES)).frame


class _Untouched(SimulatorSource):
    """The membrane of another source's scene while the object is far away."""

    def __init__(self, like: SimulatorSource, progress: Progress | None) -> None:
        self._like = like.scene
        options = dict(parse_qsl(like.name.partition("?")[2]))
        light: Any = options.get("light", "normal")
        seed, noise = int(options.get("seed", "0")) + _OTHER_SEEDS, float(options.get("noise", "1"))
        super().__init__(seed=seed, noise=noise, progress=progress, variant=Variant(press="low"), light=light)

    def _solve(self, scene: Scene, progress: Progress) -> SolvedScene:
        words, _, cells = self._like.name.rpartition("-")
        frames = (0,) * len(scene.frames)
        self.scene = replace(
            self._like, name=f"{words}-untouched-{cells}", way=((0.0, 0.0, -_AWAY_M),), drawn=(0,), frames=frames
        )
        return super()._solve(self.scene, progress)
