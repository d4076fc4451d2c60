"""The simulator as a source of frames, and its solved scenes on disk: in the user's cache, the default in the package.

A file of a scene holds the differences between successive states, compressed, and is unpacked as far as frames are
asked for. Its name contains a hash of everything that the images depend on, but not the errors of the cameras, which
are added later.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from copy import copy, deepcopy
from dataclasses import dataclass, replace
from functools import lru_cache
from io import BytesIO
from itertools import count
from pathlib import Path
from threading import Lock
from typing import IO, Any, Final
from weakref import WeakValueDictionary
from zipfile import ZipFile

import cv2
import numpy as np
from platformdirs import user_cache_dir
from pydantic import TypeAdapter

from ...errors import ExportError
from ...model.clouds import truth_points
from ...model.files import atomic_path
from ...model.frames import GroundTruth, Rig, SensorFrame, Shot
from ...model.loading import read_file
from ..base import Progress, SeekableSource
from .membrane import ON_SOLVED, Membrane
from .noise import NoiseModel
from .render import CLEAN_UNIT_M, CONTACT_FLAG
from .scene import CleanState, Press, PressFacts, simulator_rig
from .scenes import Scene, Variant, resolve_scene, write_name
from .sensors import DEFAULT_SENSOR, SENSORS, SensorModel

#: The tactile camera's exposure begins this much after the proximity camera's, seconds.
_SKEW_S: Final = 0.0021
#: Added to the seed of frames that need other noise than those that are judged.
_OTHER_SEEDS: Final = 1_000_000
#: To count up whenever a change of the code changes an image of a scene; then run ``scripts/ship_scene.py``.
_IMAGES_VERSION: Final = 4
#: Folder of the solved scenes in the package.
SHIPPED: Final = Path(__file__).with_name("solved")
#: How many equilibria are usually solved until the membrane is inflated.
_INFLATING: Final = 9
_FACTS = TypeAdapter(list[PressFacts])
_DIGEST_BYTES: Final = 32


@dataclass(frozen=True)
class SolvedScene:
    """The clean states of a scene in the order of ``Scene.drawn``, and their ground truth."""

    states: Sequence[CleanState]
    facts: Sequence[PressFacts]


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
        cameras: str = "two",
    ) -> None:
        variant = variant or Variant()
        self.scene = resolve_scene(scene, variant, cells)
        name = write_name(scene, variant, sensor, seed, noise, cameras)
        self._both = simulator_rig()
        rig = self._both if cameras == "two" else Rig.of_one_camera(self._both.tactile)
        super().__init__(name, rig, len(self.scene.frames))
        self._solved = self._solve(self.scene, progress or (lambda share, words: None))
        self.sensor = SENSORS[sensor]
        self._noise = _noise_of(self._both, seed, noise, self.sensor)
        self._made_of = (scene, seed, noise, cells, variant, sensor, cameras)

    def with_object_away(self, progress: Progress | None = None) -> SimulatorSource:
        """Return the same membrane with the object far away, and with other noise."""
        scene, seed, noise, cells, variant, sensor, cameras = self._made_of
        away = replace(variant, press="none", side=Variant.side, gap_mm=0.0)
        return SimulatorSource(scene, seed + _OTHER_SEEDS, noise, progress, cells, away, sensor, cameras)

    def with_sensor(self, sensor: SensorModel) -> SimulatorSource:
        """Return the same scene, seen by cameras with other errors but with the same random numbers."""
        other = copy(self)
        other.sensor = sensor
        other._noise = _noise_of(self._both, self._made_of[1], self._made_of[2], sensor)
        return other

    def facts(self, index: int) -> PressFacts:
        """Return depth of the press, strain and true object pose of a frame."""
        return self._solved.facts[self.scene.frames[index]]

    def read(self, index: int) -> SensorFrame:
        return self.draw(index, self.scene.frames[index])

    def draw(self, index: int, number: int) -> SensorFrame:
        """Return frame ``index``, from 0, of one of the states of ``scene.drawn``."""
        state, facts, noise = self._solved.states[number], self._solved.facts[number], self._noise
        depth = state.membrane * np.float32(CLEAN_UNIT_M)
        depth[state.membrane == 0] = np.nan
        truth = GroundTruth(
            (state.flags & CONTACT_FLAG) != 0, depth, facts.strain, facts.T_proximity_object,
            facts.force_n, state.pressure.astype(np.float32), facts.inflation_pa,
        )  # fmt: skip
        time_s, color = index / self.frame_rate_hz, noise.colour(index, 1, state.tactile_color)
        tactile = Shot(noise.tactile_depth(index, state.tactile), color, time_s)
        if not self.rig.has_proximity:
            return SensorFrame.of_shots(self.rig, index, None, tactile, self._seen_by_tactile(truth))
        proximity = Shot(noise.proximity_depth(index, state), noise.colour(index, 0, state.proximity_color), time_s)
        return SensorFrame.of_shots(self.rig, index, proximity, tactile._replace(time_s=time_s + _SKEW_S), truth)

    def _seen_by_tactile(self, truth: GroundTruth) -> GroundTruth:
        """Return contact and pressure on the tactile camera's pixels, and the force in its frame."""
        lens, shape = self._both.tactile.intrinsics, self._both.tactile.intrinsics.shape
        T_tactile_proximity = np.linalg.inv(np.array(self._both.T_proximity_tactile))
        assert truth.depth_m is not None and truth.pressure_pa is not None and truth.force_n is not None
        points = truth_points(truth, self._both) @ T_tactile_proximity[:3, :3].T + T_tactile_proximity[:3, 3]
        column, row = np.rint(lens.project(points)).astype(int).T
        inside = (column >= 0) & (column < shape[1]) & (row >= 0) & (row < shape[0])
        contact, pressure_pa, around = np.zeros(shape, np.uint8), np.zeros(shape, np.float32), np.ones((3, 3), np.uint8)
        contact[row[inside], column[inside]] = 1
        touching = truth.contact & np.isfinite(truth.depth_m)
        pressure_pa[row[inside], column[inside]] = truth.pressure_pa[touching][inside]
        closed = cv2.morphologyEx(contact, cv2.MORPH_CLOSE, around)  # the pixels are not the same
        filled = np.where((closed > 0) & (contact == 0), cv2.dilate(pressure_pa, around), pressure_pa)
        x, y, z = (T_tactile_proximity[:3, :3] @ truth.force_n).tolist()
        return GroundTruth(
            closed > 0, None, truth.strain, force_n=(x, y, z), pressure_pa=filled, inflation_pa=truth.inflation_pa
        )

    def _solve(self, scene: Scene, progress: Progress) -> SolvedScene:
        """Return the scene from the package or the cache, or compute and cache it."""
        path = cache_file(scene.name, f"{scene.key} {self._both.model_dump_json()}")
        length = len(scene.drawn)
        solved = _open_scenes.get(path) or load_scene(SHIPPED / path.name, length) or load_scene(path, length)
        if solved is None:
            solved = self.solve_anew(scene, progress)
            with suppress(ExportError):  # the next start takes as long
                save_scene(path, solved)
        _open_scenes[path] = solved
        progress(1.0, "The scene is ready")
        return solved

    def solve_anew(self, scene: Scene, progress: Progress) -> SolvedScene:
        """Solve the states in turn while a second thread draws the solved ones."""
        name = scene.name.rpartition("-")[0].replace("-", " ").replace(" none", " untouched")
        words, solved, expected = f"Computing the scene “{name}”", count(1), _INFLATING + len(scene.way)
        progress(0.0, f"{words}; slow at first")
        telling = ON_SOLVED.set(lambda: progress(0.95 * min(next(solved) / expected, 1.0), words))
        drawn: list[Future[CleanState]] = []
        facts: list[PressFacts] = []
        pool = ThreadPoolExecutor(1)
        try:
            press = Press(scene, deepcopy(_inflated(scene.design)), self._both)
            for depth, pose, state in press.states():
                drawn.append(pool.submit(press.picture, pose, state))
                facts.append(press.facts(depth, pose, state))
            return SolvedScene([future.result() for future in drawn], facts)
        finally:
            ON_SOLVED.reset(telling)
            pool.shutdown(cancel_futures=True)


#: Of many sources with the same seed: making a noise model takes a second.
_noise_of = lru_cache(maxsize=2)(NoiseModel)
#: Inflating the untouched membrane takes most of the time of a still press.
_inflated = lru_cache(maxsize=8)(Membrane)


# Solved scenes on disk


def cache_file(scene: str, key: str) -> Path:
    """Return the cache file of a scene; ``key`` is text with all its parameters."""
    digest = hashlib.sha256(f"{_IMAGES_VERSION} {key}".encode()).hexdigest()
    return Path(user_cache_dir("tactune")) / "simulator" / f"{scene}-{digest[:16]}.npz"


class _PackedStates(Sequence[CleanState]):
    """The states of a file, unpacked up to the last one that was asked for; a run of few frames needs few."""

    def __init__(self, archive: ZipFile, count: int) -> None:
        self._count, self._lock = count, Lock()
        self._unpacked: list[CleanState] = []
        self._streams: dict[str, tuple[IO[bytes], tuple[int, ...], np.dtype[Any]]] = {}
        for name in CleanState._fields:
            stream = archive.open(f"{name}.npy")
            np.lib.format.read_magic(stream)
            shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
            self._streams[name] = stream, shape[1:], dtype

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: Any) -> Any:
        number = range(self._count)[index]
        with self._lock:
            while len(self._unpacked) <= number:
                self._unpacked.append(self._next())
        return self._unpacked[number]

    def _next(self) -> CleanState:
        images: dict[str, Any] = {}
        for name, (stream, shape, dtype) in self._streams.items():
            image = np.frombuffer(bytearray(stream.read(math.prod(shape) * dtype.itemsize)), dtype).reshape(shape)
            if self._unpacked:
                image += getattr(self._unpacked[-1], name)
            images[name] = image
        return CleanState(**images)


def load_scene(path: Path, count: int) -> SolvedScene | None:
    """Return ``count`` states from a file, or None where it is missing or damaged."""
    try:
        packed = read_file(path)
        if hashlib.sha256(packed[:-_DIGEST_BYTES]).digest() != packed[-_DIGEST_BYTES:]:
            return None
        archive = ZipFile(BytesIO(packed))
        facts = _FACTS.validate_json(np.load(BytesIO(archive.read("facts.npy"))).tobytes())
        states = _PackedStates(archive, count)
    except Exception:  # a damaged file may raise anything
        return None
    return SolvedScene(states, facts) if len(facts) == count else None


def save_scene(path: Path, scene: SolvedScene) -> None:
    """Write a scene to a file, whole or not at all: an .npz whose comment is the hash of all before it."""
    arrays: dict[str, Any] = {"facts": np.frombuffer(_FACTS.dump_json(list(scene.facts)), np.uint8)}
    for name in CleanState._fields:
        arrays[name] = np.stack([getattr(state, name) for state in scene.states])
        arrays[name][1:] -= arrays[name][:-1].copy()
    packed = BytesIO()
    np.savez_compressed(packed, **arrays)
    # the last two bytes of a zip file are the length of its comment
    content = packed.getvalue()[:-2] + _DIGEST_BYTES.to_bytes(2, "little")
    with atomic_path(path) as temporary:
        temporary.write_bytes(content + hashlib.sha256(content).digest())
