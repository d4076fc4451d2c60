"""Alignment of a scan with a patch: the immutable state, its undoable edits, and the file that keeps it."""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from PyQt6.QtCore import QObject, pyqtSignal

from ...core.errors import CalibrationError
from ...core.estimation.start_pose import pose_from_pairs, save_transform
from ...core.lab.scan import PaintSettings
from ...core.model.arrays import Float32Array, Float64Array
from ...core.model.clouds import deproject, valid_depth
from ...core.model.files import atomic_path
from ...core.model.frames import Matrix4, rigid_transform
from ...core.model.loading import parse_npz, read_file
from ...core.preset import now
from ..document.history import History
from ..document.keeping import KeptState, check_version, remove_unnamed, write_json
from ..worker.results import Result

#: Points kept around the patch: every n-th row and column, within this distance of its bounding box, metres.
_CONTEXT_STEP = 3
_CONTEXT_MARGIN_M = 0.06


@dataclass(frozen=True, eq=False)
class FrozenPatch:
    """The contact patch of one frame. Two patches with equal points are equal.

    Attributes
    ----------
    points, context : float32, shapes (N, 3) and (M, 3)
        Contact points, and some proximity points around them; metres, proximity depth frame.
    area_mm2 : float
        Projected area, as in the main window.
    source : str
        Name of the source.
    frame : int
        Number of the frame within the source, from 0.
    preset : str
        File or name of the preset for ``load_preset``; empty if it was not saved.
    """

    points: Float32Array
    context: Float32Array
    area_mm2: float
    source: str
    frame: int
    preset: str

    @classmethod
    def of(cls, result: Result, preset: str) -> FrozenPatch:
        """Return the patch of a result."""
        patch = result.patch
        points = np.empty((0, 3), np.float32) if patch is None else patch.points
        frame = result.playback.index if result.playback.seekable else result.frame.sequence
        return cls(points, _around(result, points), result.area_mm2, result.source.name, frame, preset)

    @cached_property
    def digest(self) -> str:
        """Digest that identifies the patch."""
        told = hashlib.blake2b(digest_size=12)
        for array in (self.points, self.context):
            told.update(np.ascontiguousarray(array).tobytes())
        told.update(f"{self.source} {self.frame} {self.preset}".encode())
        return told.hexdigest()

    @property
    def title(self) -> str:
        """Name of the frame as displayed; frames count from 1."""
        return f"frame {self.frame + 1} of {self.source}"

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, FrozenPatch) and other.digest == self.digest)

    def __hash__(self) -> int:
        return hash(self.digest)


def _around(result: Result, points: Float32Array) -> Float32Array:
    """Return proximity points near the patch; without a patch, all points in the range of the views."""
    camera, counts = result.source.rig.proximity, result.frame.proximity_depth
    chosen = np.zeros(counts.shape, np.bool_)
    chosen[::_CONTEXT_STEP, ::_CONTEXT_STEP] = valid_depth(counts[::_CONTEXT_STEP, ::_CONTEXT_STEP])
    around = deproject(counts, camera, np.flatnonzero(chosen))
    if len(points):
        low, high = points.min(axis=0) - _CONTEXT_MARGIN_M, points.max(axis=0) + _CONTEXT_MARGIN_M
        return np.asarray(around[((around >= low) & (around <= high)).all(axis=1)])
    near, far = result.rendered.depth_range_m
    return np.asarray(around[(around[:, 2] >= near) & (around[:, 2] <= far)])


Place = tuple[float, float, float]
Side = Literal["scan", "patch"]
#: Origin of a pose.
Origin = Literal["", "pairs", "hand", "ICP", "file"]

MIN_PAIRS = 3


@dataclass(frozen=True)
class PickedPair:
    """A point on the scan (scan frame) and the same point on the patch (proximity frame), metres."""

    scan: Place | None = None
    patch: Place | None = None

    @property
    def complete(self) -> bool:
        """Whether both sides are clicked."""
        return self.scan is not None and self.patch is not None


@dataclass(frozen=True)
class TruthState:
    """Everything that is undone, redone and saved for one scan.

    Attributes
    ----------
    pose : 4 x 4 nested tuples or None
        ``T_proximity_scan``.
    patch : FrozenPatch or None
        None while the views follow the main window.
    """

    paint: PaintSettings = field(default_factory=PaintSettings)
    pairs: tuple[PickedPair, ...] = ()
    pose: Matrix4 | None = None
    origin: Origin = ""
    patch: FrozenPatch | None = None

    @property
    def empty(self) -> bool:
        """Whether nothing was edited yet."""
        return self == TruthState()

    @property
    def matched(self) -> tuple[list[Place], list[Place]]:
        """Both sides of the complete pairs: points on the scan, points on the patch."""
        both = [(pair.scan, pair.patch) for pair in self.pairs if pair.scan is not None and pair.patch is not None]
        return [scan for scan, _ in both], [patch for _, patch in both]

    @property
    def pending(self) -> PickedPair | None:
        """The pair whose second side is missing; always the last one."""
        return self.pairs[-1] if self.pairs and not self.pairs[-1].complete else None


class TruthSession(History[TruthState]):
    """Alignment of a scan, or of another ``thing``, with a patch; every edit is one undoable step.

    Signals
    -------
    refused(sentence: str)
        An edit did not give a pose; empty when one does.
    """

    refused = pyqtSignal(str)

    def __init__(self, parent: QObject | None = None, thing: str = "scan") -> None:
        super().__init__(TruthState(), parent)
        self._thing = thing

    def set_paint(self, paint: PaintSettings, gesture: int = 0) -> None:
        """Change the paint's colours or clean-up."""
        self.edit("Change the paint's colours", replace(self._state, paint=paint), gesture)

    def freeze(self, patch: FrozenPatch | None) -> None:
        """Align to this patch from now on; None follows the main window again."""
        text = "Follow the main window" if patch is None else f"Align to {patch.title}"
        self.edit(text, replace(self._state, patch=patch))

    def click(self, side: Side, place: Place, patch: FrozenPatch | None) -> None:
        """Process a click: it starts a pair, moves its first click, or completes it and fits the pose."""
        state = self._held(patch)
        pending = state.pending
        pair = replace(pending or PickedPair(), **{side: place})
        pairs = (*(state.pairs[:-1] if pending else state.pairs), pair)
        self._edit_pairs(f"Click point {len(pairs)}", replace(state, pairs=pairs))

    def remove(self, number: int) -> None:
        """Delete a pair by its index."""
        pairs = tuple(pair for at, pair in enumerate(self._state.pairs) if at != number)
        self._edit_pairs(f"Delete pair {number + 1}", replace(self._state, pairs=pairs))

    def remove_all(self) -> None:
        """Delete all pairs and keep the pose."""
        self.edit("Delete all pairs", replace(self._state, pairs=()))

    def set_pose(
        self, pose: npt.ArrayLike, origin: Origin, text: str, patch: FrozenPatch | None, gesture: int = 0
    ) -> None:
        """Set the pose. ``patch`` is frozen if no patch is frozen yet."""
        try:
            rigid = rigid_transform(pose)
        except ValueError as error:
            self.refused.emit(f"The {self._thing} was not moved: {error}.")
            return
        self.refused.emit("")
        self.edit(text, replace(self._held(patch), pose=rigid, origin=origin), gesture)

    def nudge(self, change: Float64Array, patch: FrozenPatch | None, gesture: int) -> None:
        """Move and turn the scan by a transform of the proximity frame; ``patch`` as for `set_pose`."""
        if self._state.pose is None:
            return
        pose = change @ np.asarray(self._state.pose)
        left, _, right = np.linalg.svd(pose[:3, :3])
        pose[:3, :3] = left @ right  # keep it a rotation: rounding errors of many small turns add up
        self.set_pose(pose, "hand", f"Nudge the {self._thing}", patch, gesture)

    def _held(self, patch: FrozenPatch | None) -> TruthState:
        return self._state if self._state.patch is not None else replace(self._state, patch=patch)

    def _edit_pairs(self, text: str, after: TruthState) -> None:
        """Set the pairs. If there are enough, fit the pose to them."""
        matched, sentence = after.matched, ""
        if len(matched[0]) >= MIN_PAIRS and matched != self._state.matched:
            try:
                pose = pose_from_pairs(*matched)
                after = replace(after, pose=pose, origin="pairs")
            except CalibrationError as error:
                sentence = f"No pose from these pairs: {error}."
        self.edit(text, after)
        self.refused.emit(sentence)


_VERSION = 1


class TruthKeeper(KeptState[TruthState]):
    """Keeps a session's state in a folder. Patches are separate files, named by their digest."""

    def __init__(self, session: TruthSession, folder: Path, parent: QObject | None = None) -> None:
        self._session = session
        super().__init__(folder, "alignment", parent)
        self._key = ""
        self._lost = ""
        self._stored: set[str] = set()
        self._seen: dict[str, tuple[TruthState, datetime]] = {}
        session.changed.connect(self.schedule)

    @property
    def transform_file(self) -> Path:
        """File with the pose of the current scan, for the command line."""
        return self.folder / f"scan-{self._key}.transform.json"

    def present(self) -> TruthState:
        """Return the session's state."""
        return self._session.state

    def switch_to(self, key: str) -> datetime | None:
        """Save the current scan's work and restore another's. Return when that was saved, or None if there is none."""
        self.flush()
        if self._key:
            self._seen[self._key] = self._session.state, now()
        self._key = key
        file = self.folder / f"scan-{key}.json" if key else None
        found = self._seen.get(key) or (None if file is None else self._read(file))
        state = found[0] if found else TruthState()
        self.follow(file, state)
        self._session.start(state)
        return found[1] if found and not found[0].empty else None

    def close(self) -> None:
        """Write the last state and remove old patches that no saved scan refers to."""
        self.flush()
        self.on_disk(
            remove_unnamed,
            self.folder,
            "scan-*[0-9a-f].json",
            lambda content: [_patch_file(self.folder, content["patch"]["digest"]).name] if content["patch"] else [],
            "patch-*.npz",
        )
        self.finish()

    def write(self, state: TruthState, file: Path) -> None:
        """Write the patch, the state that refers to it, and the pose for the command line."""
        if state.patch is not None:
            self._write_patch(state.patch)
        write_json(file, _content(state))
        if state.pose is not None:
            save_transform(file.with_suffix(".transform.json"), state.pose)

    def _parse(self, content: dict[str, Any]) -> TruthState:
        """Return the saved state, without its patch if that is missing."""
        check_version(content, _VERSION)
        paint: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value for name, value in content["paint"].items()
        }
        pose, patch, self._lost = content["pose"], None, ""
        if content["patch"] is not None:
            try:
                patch = _read_patch(self.folder, content["patch"])
            except (OSError, ValueError, KeyError) as error:
                self._lost = str(error)
        return TruthState(
            paint=PaintSettings(**paint),
            pairs=tuple(PickedPair(_place(pair["scan"]), _place(pair["patch"])) for pair in content["pairs"]),
            pose=None if pose is None else rigid_transform(pose),
            origin=content["origin"],
            patch=patch,
        )

    def _read(self, file: Path) -> tuple[TruthState, datetime] | None:
        self._lost = ""
        found = self.read(file, self._parse)
        if self._lost and found is not None:
            self.failed.emit(f"The patch that this scan was aligned to is gone ({self._lost}); pairs and pose remain.")
        return found

    def _write_patch(self, patch: FrozenPatch) -> None:
        """Write a patch once; a file that another process left under its name may be damaged and is replaced."""
        file = _patch_file(self.folder, patch.digest)
        if patch.digest in self._stored and file.exists():
            return
        with atomic_path(file) as temporary:
            np.savez_compressed(temporary, points=patch.points, context=patch.context)
        self._stored.add(patch.digest)


def _content(state: TruthState) -> dict[str, Any]:
    patch = state.patch
    return {
        "version": _VERSION,
        "paint": asdict(state.paint),
        "pairs": [asdict(pair) for pair in state.pairs],
        "pose": state.pose,
        "origin": state.origin,
        "patch": None if patch is None else {
            "digest": patch.digest, "area_mm2": patch.area_mm2, "source": patch.source, "frame": patch.frame,
            "preset": patch.preset,
        },
    }  # fmt: skip


def _place(values: Any) -> Place | None:
    if values is None:
        return None
    x, y, z = (float(value) for value in values)
    return x, y, z


def _patch_file(folder: Path, digest: str) -> Path:
    return folder / f"patch-{digest}.npz"


def _read_patch(folder: Path, told: dict[str, Any]) -> FrozenPatch:
    stored = parse_npz(read_file(_patch_file(folder, told["digest"])))
    points, context = stored["points"], stored["context"]
    patch = FrozenPatch(points, context, told["area_mm2"], told["source"], told["frame"], told["preset"])
    if patch.digest != told["digest"]:
        raise ValueError(f"the patch {told['digest']} has been changed")
    return patch
