"""The simulator as a source of frames."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from copy import deepcopy
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Final
from weakref import WeakValueDictionary

import numpy as np

from ...errors import ExportError
from ...model.frames import GroundTruth, SensorFrame
from ..base import Progress, SeekableSource
from .cache import SolvedScene, cache_file, find_solved, save_scene
from .membrane import Membrane
from .mesh import MembraneDesign
from .names import name_values, write_name
from .noise import NoiseModel
from .render import CLEAN_UNIT_M, CONTACT_FLAG
from .scene import CleanState, Press, PressFacts, simulator_rig
from .scenes import Scene, Variant, resolve_scene
from .sensors import DEFAULT_SENSOR, SENSORS

#: The tactile camera's exposure begins this much after the proximity camera's, seconds.
_SKEW_S: Final = 0.0021
#: Added to the seed of frames that need other noise than those that are judged.
_OTHER_SEEDS: Final = 1_000_000
#: Open scenes of this process, shared because each takes some 200 MB.
_open_scenes: WeakValueDictionary[Path, SolvedScene] = WeakValueDictionary()


class SimulatorSource(SeekableSource):
    """A simulated sensor, pressed by an object as the scene says; usually it approaches, presses, holds and leaves.

    The clean images of a scene are computed once (some ten seconds) and cached in the user's cache folder; those of the
    default scene come with the package. Noise is added frame by frame. A frame depends on scene, sensor, seed, noise
    and its index only.
    """

    def __init__(
        self,
        scene: str = "cup",
        seed: int = 0,
        noise: float = 1.0,
        progress: Progress | None = None,
        cells: tuple[int, int] | None = None,
        variant: Variant | None = None,
        sensor: str = DEFAULT_SENSOR,
    ) -> None:
        variant = variant or Variant()
        self.scene = resolve_scene(scene, variant, cells)
        name = write_name(name_values(scene, variant, sensor, seed, noise))
        super().__init__(name, simulator_rig(), len(self.scene.frames))
        self._solved = self._solve(self.scene, progress or (lambda share, words: None))
        self._noise = NoiseModel(self.rig, seed, noise, SENSORS[sensor])
        self._made_of = (scene, seed, noise, cells, variant, sensor)

    def with_object_away(self, progress: Progress | None = None) -> SimulatorSource:
        """Return the same membrane with the object far away, and with other noise."""
        scene, seed, noise, cells, variant, sensor = self._made_of
        away = replace(variant, press="none", side=Variant.side, gap_mm=0.0)
        return SimulatorSource(scene, seed + _OTHER_SEEDS, noise, progress, cells, away, sensor)

    def facts(self, index: int) -> PressFacts:
        """Return depth of the press, strain and true object pose of a frame."""
        return self._solved.facts[self.scene.frames[index]]

    def read(self, index: int) -> SensorFrame:
        """Return frame ``index``, 0 <= index < length."""
        return self.draw(index, self.scene.frames[index])

    def draw(self, index: int, number: int) -> SensorFrame:
        """Return frame ``index``, from 0, of one of the states of ``scene.drawn``."""
        state, facts, noise = self._solved.states[number], self._solved.facts[number], self._noise
        depth = state.membrane * np.float32(CLEAN_UNIT_M)
        depth[state.membrane == 0] = np.nan
        return SensorFrame(
            sequence=index,
            proximity_depth=noise.proximity_depth(index, state),
            tactile_depth=noise.tactile_depth(index, state.tactile),
            proximity_color=noise.colour(index, 0, state.proximity_color),
            tactile_color=noise.colour(index, 1, state.tactile_color),
            proximity_time_s=index / self.frame_rate_hz,
            tactile_time_s=index / self.frame_rate_hz + _SKEW_S,
            truth=GroundTruth((state.flags & CONTACT_FLAG) != 0, depth, facts.strain, facts.T_proximity_object),
        )

    def _solve(self, scene: Scene, progress: Progress) -> SolvedScene:
        """Return the scene from the package or the cache, or compute and cache it."""
        path = cache_file(scene.name, f"{scene.key} {self.rig.model_dump_json()}")
        progress(0.0, f"Looking for the scene {_title(scene)} in the cache")
        solved = _open_scenes.get(path) or find_solved(path, len(scene.drawn))
        if solved is None:
            solved = self.solve_anew(scene, progress)
            with suppress(ExportError):  # the next start takes as long
                save_scene(path, solved)
        _open_scenes[path] = solved
        progress(1.0, f"The scene {_title(scene)} is ready")
        return solved

    def _press(self, scene: Scene) -> Press:
        """Return the press that is solved and drawn."""
        return Press(scene, deepcopy(_inflated(scene.design)), self.rig)

    def solve_anew(self, scene: Scene, progress: Progress) -> SolvedScene:
        """Solve the states in turn while a second thread draws the solved ones."""
        progress(0.0, "Inflating the simulated membrane; the very first time its solver is compiled, too")
        press = self._press(scene)
        drawn: list[Future[CleanState]] = []
        facts: list[PressFacts] = []
        pool = ThreadPoolExecutor(1)
        try:
            for depth, pose, state in press.states():
                drawn.append(pool.submit(press.picture, pose, state))
                facts.append(press.facts(depth, pose, state))
                progress(0.95 * len(drawn) / len(scene.drawn), f"Computing the scene {_title(scene)}")
            return SolvedScene([future.result() for future in drawn], facts)
        finally:
            pool.shutdown(cancel_futures=True)


@lru_cache(maxsize=8)
def _inflated(design: MembraneDesign) -> Membrane:
    """Return the untouched membrane; inflating it takes most of the time of a still press."""
    return Membrane(design)


def _title(scene: Scene) -> str:
    return scene.name.rpartition("-")[0].replace("-", " ")
