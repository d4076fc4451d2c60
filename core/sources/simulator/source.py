"""The simulator as a source of frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from copy import deepcopy
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Final, get_args
from weakref import WeakValueDictionary

import cv2
import numpy as np

from ...errors import ExportError, SourceError
from ...model.arrays import Uint8Array
from ...model.frames import GroundTruth, SensorFrame, TrueStrain
from ..base import Health, Progress, SeekableSource
from .between import facts_between, state_between
from .cache import SolvedScene, cache_file, find_solved, save_scene
from .membrane import Membrane
from .mesh import MembraneDesign
from .names import write_name
from .noise import NoiseModel
from .render import CLEAN_UNIT_M, CONTACT_FLAG
from .scene import CleanState, Press, PressFacts, simulator_rig
from .scenes import Light, Scene, Variant, light_table, resolve_scene
from .sensors import DEFAULT_SENSOR, find_sensor
from .tray import carried

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
        light: Light = "normal",
        sensor: str = DEFAULT_SENSOR,
    ) -> None:
        if seed < 0:
            raise SourceError(f"sim: the seed is {seed}; give a whole number from 0")
        if not (math.isfinite(noise) and noise >= 0.0):
            raise SourceError(f"sim: the noise is {noise}; give a number from 0, where 1 is as the sensor says")
        if light not in get_args(Light):
            raise SourceError(f"sim: light is {light!r}; choose normal, bright or dim")
        variant, errors = variant or Variant(), find_sensor(sensor)
        self.scene = resolve_scene(scene, variant, cells)
        super().__init__(_name(scene, seed, noise, variant, light, sensor), simulator_rig(), len(self.scene.frames))
        self._message = ""
        self._solved = self._solve(self.scene, progress or (lambda share, words: None))
        if self.scene.loaded:
            self.scene = replace(self.scene, frames=carried(self._solved.facts, self.frame_rate_hz))
            self._length = len(self.scene.frames)
        self._noise = NoiseModel(self.rig, seed, noise, errors)
        self._light = light_table(light)
        self._made_of = (scene, seed, noise, cells, variant, light, sensor)

    @property
    def held_out(self) -> bool:
        """Whether the object, the membrane or the sensor is reserved for judging methods, not for developing them."""
        return self.scene.held_out or self._noise.sensor.held_out

    def with_object_away(self, progress: Progress | None = None) -> SimulatorSource:
        """Return the same membrane with the object far away, and with other noise."""
        scene, seed, noise, cells, variant, light, sensor = self._made_of
        away = replace(variant, press="none", side=Variant.side, gap_mm=Variant.gap_mm)
        return SimulatorSource(scene, seed + _OTHER_SEEDS, noise, progress, cells, away, light, sensor)

    def facts(self, index: int) -> PressFacts:
        """Return depth of the press, strain, force and true object pose of a frame."""
        return facts_between(self._solved.facts, self.scene.frames[index])

    def solved_facts(self) -> Sequence[PressFacts]:
        """Return those of the solved states, in the order of ``scene.drawn``."""
        return self._solved.facts

    def health(self) -> Health:
        """Report a cache that could not be written."""
        return Health(message=self._message)

    def read(self, index: int) -> SensorFrame:
        """Return frame ``index``, 0 <= index < length."""
        return self.draw(index, self.scene.frames[index])

    def draw(self, index: int, place: float) -> SensorFrame:
        """Return frame ``index``, from 0, of a state of ``scene.drawn``, or between two of them."""
        state = state_between(self._solved.states, place)
        noise = self._noise
        depth = state.membrane * np.float32(CLEAN_UNIT_M)
        depth[state.membrane == 0] = np.nan
        facts = facts_between(self._solved.facts, place)
        return SensorFrame(
            sequence=index,
            proximity_depth=noise.proximity_depth(index, state.behind, state.membrane, state.cosine, state.flags),
            tactile_depth=noise.tactile_depth(index, state.tactile),
            proximity_color=noise.colour(index, 0, self._lit(state.proximity_color)),
            tactile_color=noise.colour(index, 1, self._lit(state.tactile_color)),
            proximity_time_s=index / self.frame_rate_hz,
            tactile_time_s=index / self.frame_rate_hz + _SKEW_S,
            truth=GroundTruth((state.flags & CONTACT_FLAG) != 0, depth, _true_strain(facts), facts.T_proximity_object),
        )

    def _lit(self, image: Uint8Array) -> Uint8Array:
        """Change the light on a colour image."""
        if self._light is None:
            return image
        return np.asarray(cv2.LUT(image, self._light[None]), dtype=np.uint8)

    def _solve(self, scene: Scene, progress: Progress) -> SolvedScene:
        """Return the scene from the package or the cache, or compute and cache it."""
        path = cache_file(scene.name, f"{scene.key} {self.rig.model_dump_json()}")
        progress(0.0, f"Looking for the scene {_title(scene)} in the cache")
        solved = _open_scenes.get(path) or find_solved(path, len(scene.drawn))
        if solved is None:
            solved = self._compute(scene, progress)
            try:
                save_scene(path, solved)
            except ExportError as error:
                self._message = f"The scene was not kept, so the next start takes as long: {error}"
        _open_scenes[path] = solved
        progress(1.0, f"The scene {_title(scene)} is ready")
        return solved

    def solve_anew(self, progress: Progress) -> SolvedScene:
        """Return the states of the scene, computed without looking for a file, and keep no file."""
        return self._compute(self.scene, progress)

    def _press(self, scene: Scene) -> Press:
        """Return the press that is solved and drawn."""
        return Press(scene, deepcopy(_inflated(scene.design)), self.rig)

    def _compute(self, scene: Scene, progress: Progress) -> SolvedScene:
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


def _true_strain(facts: PressFacts) -> TrueStrain:
    return TrueStrain(
        largest=facts.max_strain,
        length=facts.strain_length,
        width=facts.strain_width,
        length_seen=facts.strain_length_seen,
        width_seen=facts.strain_width_seen,
    )


def _title(scene: Scene) -> str:
    return scene.name.rpartition("-")[0].replace("-", " ")


def _name(scene: str, seed: int, noise: float, variant: Variant, light: Light, sensor: str) -> str:
    options = {"press": variant.press, "move": variant.move, "side": variant.side, "object": variant.object}
    options |= {
        "gap": f"{variant.gap_mm:g}",
        "membrane": variant.membrane,
        "grid": variant.grid,
        "light": light,
        "sensor": sensor,
    }
    return write_name(options | {"scene": scene, "seed": str(seed), "noise": f"{noise:g}"})
