"""The simulator as a source of frames."""

from __future__ import annotations

import math
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Final, get_args
from weakref import WeakValueDictionary

import cv2
import numpy as np

from ...errors import ExportError, SourceError
from ...model.arrays import Uint8Array
from ...model.frames import GroundTruth, SensorFrame, TrueStrain
from ..base import Health, Progress, SeekableSource
from .cache import SolvedScene, cache_file, load_scene, save_scene
from .membrane import Membrane
from .noise import NoiseModel
from .render import CLEAN_UNIT_M, CONTACT_FLAG
from .scene import CleanState, Press, PressFacts, simulator_rig
from .scenes import Light, Scene, Variant, light_table, resolve_scene

#: The tactile camera's exposure begins this much after the proximity camera's, seconds.
_SKEW_S: Final = 0.0021

#: Added to the seed of frames that must not have the noise of those that are judged.
_OTHER_SEEDS: Final = 1_000_000

#: Scenes that a source in this process has open, shared because each takes some 200 MB.
_open_scenes: WeakValueDictionary[Path, SolvedScene] = WeakValueDictionary()


class SimulatorSource(SeekableSource):
    """A simulated sensor, pressed by an object that comes, presses, holds and leaves, or does as another scene says.

    The clean images of a scene are computed once (some ten seconds) and kept in the user's cache
    folder; the noise is added frame by frame. A frame depends on nothing but scene, seed, noise and
    its index.

    Parameters
    ----------
    scene : str
        One of `scenes.SCENES`.
    seed : int
        From 0; chooses the noise.
    noise : float
        1: as the cameras' data sheets give it; 0: none; 2: twice as much.
    progress : callable, optional
        Told the share done, 0 to 1, and what is being done.
    cells : tuple of int, optional
        Resolution of the membrane's mesh along its sides, even numbers; the design's own by default.
    variant : Variant, optional
        Which press, object, gap and print.
    light : {"normal", "bright", "dim"}
        Light on the colour cameras, which shifts the mask's colours.

    Raises
    ------
    SourceError
        No such scene, or an option that it does not have, or a seed, noise or light that is not allowed.
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
    ) -> None:
        if seed < 0:
            raise SourceError(f"sim: the seed is {seed}; give a whole number from 0")
        if not (math.isfinite(noise) and noise >= 0.0):
            raise SourceError(f"sim: the noise is {noise}; give a number from 0, where 1 is as in the data sheets")
        if light not in get_args(Light):
            raise SourceError(f"sim: light is {light!r}; choose normal, bright or dim")
        variant = variant or Variant()
        self.scene = resolve_scene(scene, variant, cells)
        super().__init__(_name(scene, seed, noise, variant, light), simulator_rig(), len(self.scene.frames))
        self._message = ""
        self._solved = self._solve(self.scene, progress or (lambda share, words: None))
        self._noise = NoiseModel(self.rig, seed, noise)
        self._light = light_table(light)
        self._made_of = (scene, seed, noise, cells, variant, light)

    @property
    def held_out(self) -> bool:
        """Whether methods must not be developed on this scene, only judged."""
        return self.scene.pressed.held_out

    def with_object_away(self, progress: Progress | None = None) -> SimulatorSource:
        """Return the same membrane with the object far away; its noise is none that a frame of this source has."""
        scene, seed, noise, cells, variant, light = self._made_of
        away = Variant(press="none", object=variant.object, grid=variant.grid)
        return SimulatorSource(scene, seed + _OTHER_SEEDS, noise, progress, cells, away, light)

    def facts(self, index: int) -> PressFacts:
        """Return depth of the press, strain, force and true object pose of a frame."""
        facts: PressFacts = self._solved.facts[self.scene.frames[index]]
        return facts

    def health(self) -> Health:
        """Report that the cache could not be written, if so; all else is well."""
        return Health(message=self._message)

    def read(self, index: int) -> SensorFrame:
        """Return frame ``index``, 0 <= index < length."""
        state = self._solved.states[self.scene.frames[index]]
        noise = self._noise
        depth = state.membrane * np.float32(CLEAN_UNIT_M)
        depth[state.membrane == 0] = np.nan
        return SensorFrame(
            sequence=index,
            proximity_depth=noise.proximity_depth(index, state.behind, state.membrane, state.cosine, state.flags),
            tactile_depth=noise.tactile_depth(index, state.tactile),
            proximity_color=noise.colour(index, 0, self._lit(state.proximity_color)),
            tactile_color=noise.colour(index, 1, self._lit(state.tactile_color)),
            proximity_time_s=index / self.frame_rate_hz,
            tactile_time_s=index / self.frame_rate_hz + _SKEW_S,
            truth=GroundTruth((state.flags & CONTACT_FLAG) != 0, depth, _true_strain(self.facts(index))),
        )

    def _lit(self, image: Uint8Array) -> Uint8Array:
        """Change the light on a colour image."""
        if self._light is None:
            return image
        return np.asarray(cv2.LUT(image, self._light[None]), dtype=np.uint8)

    def _solve(self, scene: Scene, progress: Progress) -> SolvedScene:
        """Take the scene from the cache, or compute and keep it."""
        path = cache_file(scene.name, f"{scene.key} {self.rig.model_dump_json()}")
        progress(0.0, f"Looking for the {_title(scene)} scene in the cache")
        solved = _open_scenes.get(path) or load_scene(path, len(scene.drawn))
        if solved is None:
            solved = self._compute(scene, progress)
            try:
                save_scene(path, solved)
            except ExportError as error:
                self._message = f"The scene was not kept, so the next start takes as long: {error}"
        _open_scenes[path] = solved
        progress(1.0, f"The {_title(scene)} scene is ready")
        return solved

    def _compute(self, scene: Scene, progress: Progress) -> SolvedScene:
        """Solve state after state while a second thread draws the ones before."""
        progress(0.0, "Inflating the simulated membrane; the very first time its solver is compiled, too")
        press = Press(scene, Membrane(scene.design), self.rig)
        drawn: list[Future[CleanState]] = []
        facts: list[PressFacts] = []
        pool = ThreadPoolExecutor(1)
        try:
            for depth, pose, state in press.states():
                drawn.append(pool.submit(press.picture, pose, state))
                facts.append(press.facts(depth, pose, state))
                progress(0.95 * len(drawn) / len(scene.drawn), f"Pressing the {_title(scene)} into the membrane")
            return SolvedScene([future.result() for future in drawn], facts)
        finally:
            pool.shutdown(cancel_futures=True)


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


def _name(scene: str, seed: int, noise: float, variant: Variant, light: Light) -> str:
    plain = Variant()
    options = [f"press={variant.press}"] * bool(variant.press)
    options += [f"side={variant.side}"] * (variant.side != plain.side)
    options += [f"object={variant.object}"] * (variant.object != plain.object)
    options += [f"gap={variant.gap_mm:g}"] * (variant.gap_mm != plain.gap_mm)
    options += [f"grid={variant.grid}"] * (variant.grid != plain.grid)
    options += [f"light={light}"] * (light != "normal")
    options += [f"seed={seed}"] * (seed != 0) + [f"noise={noise:g}"] * (noise != 1.0)
    return f"sim:{scene}" + ("?" + "&".join(options) if options else "")
