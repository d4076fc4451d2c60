"""The calibration in progress: snapshots, point pairs and choices, all immutable, and their undoable edits."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict
from PyQt6.QtCore import QObject, pyqtSignal

from ...core.calibration.calibrate import DepthChoice
from ...core.errors import counted
from ...core.model.frames import Rig, SensorFrame
from ..document.history import History

Side = Literal["proximity", "tactile"]
ProximityImage = Literal["color", "depth"]
ImageChoice = Literal["color", "depth", "relative"]
ModelChoice = Literal["auto", "rigid", "homography"]
Target = Literal["texture", "chessboard", "charuco", "circles", "dots"]
Place = tuple[float, float]

SIDES: tuple[Side, Side] = ("proximity", "tactile")


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class PointPair(_Frozen):
    """A point clicked in both images. While one side is missing, the pair is pending.

    ``proximity_image`` names the image whose pixels the proximity side is given in. ``tactile_depth_m`` is None where
    the tactile camera has no depth. ``snapshot`` is a digest; it is empty for imported pairs.
    """

    key: int
    enabled: bool = True
    proximity: Place | None = None
    tactile: Place | None = None
    tactile_depth_m: float | None = None
    proximity_image: ProximityImage = "color"
    snapshot: str = ""
    origin: str = "clicked"

    @property
    def complete(self) -> bool:
        """Whether both sides are clicked."""
        return self.proximity is not None and self.tactile is not None

    def place(self, side: Side) -> Place | None:
        """Return one side."""
        return self.proximity if side == "proximity" else self.tactile


class Choices(_Frozen):
    """The options chosen on the pages.

    ``target`` is what *Find points* looks for; ``columns``, ``rows``, ``marker_share`` and ``dictionary`` describe a
    printed target, see `tactune.core.calibration.detect`.
    """

    snapshot: str = ""
    proximity_image: ImageChoice = "color"
    tactile_image: ImageChoice = "color"
    stretch: bool = True
    snap: bool = True
    average: int = 10
    target: Target = "texture"
    columns: int = 9
    rows: int = 6
    marker_share: float = 0.7
    dictionary: str = "DICT_4X4_250"
    model: ModelChoice = "auto"
    depth_fit: DepthChoice = "auto"
    set_tolerance: bool = False
    estimate_distortion: bool = False


@dataclass(frozen=True, eq=False)
class Snapshot:
    """One averaged frame.

    ``moved_m`` is how far the membrane moved while it was taken; ``source`` names where it was taken, empty if unknown.
    """

    digest: str
    name: str
    frame: SensorFrame
    averaged: int = 1
    moved_m: float = 0.0
    source: str = ""


@dataclass(frozen=True)
class SessionState:
    """Everything that undo restores."""

    snapshots: tuple[Snapshot, ...] = ()
    pairs: tuple[PointPair, ...] = ()
    choices: Choices = field(default_factory=Choices)

    @property
    def empty(self) -> bool:
        """Whether there is neither a snapshot nor a pair."""
        return not self.snapshots and not self.pairs

    @property
    def complete_pairs(self) -> tuple[PointPair, ...]:
        """Pairs with both sides."""
        return tuple(pair for pair in self.pairs if pair.complete)

    @property
    def pending(self) -> PointPair | None:
        """The pair whose second click is missing."""
        return next((pair for pair in self.pairs if not pair.complete), None)

    @property
    def snapshot(self) -> Snapshot | None:
        """The snapshot that is being clicked in."""
        chosen = self.choices.snapshot
        return next((snap for snap in self.snapshots if snap.digest == chosen), None)

    @property
    def sources(self) -> tuple[str, ...]:
        """The sources that the snapshots were taken from, each once; unknown ones are left out."""
        return tuple(dict.fromkeys(snap.source for snap in self.snapshots if snap.source))

    def snapshot_of(self, pair: PointPair) -> Snapshot | None:
        """Return the snapshot in which a pair was clicked."""
        return next((snap for snap in self.snapshots if snap.digest == pair.snapshot), None)

    def next_key(self) -> int:
        """Return the number of the next pair."""
        return max((pair.key for pair in self.pairs), default=0) + 1

    def with_pair(self, pair: PointPair) -> SessionState:
        """Replace the pair of the same key, or add it."""
        if any(old.key == pair.key for old in self.pairs):
            return replace(self, pairs=tuple(pair if old.key == pair.key else old for old in self.pairs))
        return replace(self, pairs=(*self.pairs, pair))

    def with_choices(self, **values: object) -> SessionState:
        """Change choices."""
        return replace(self, choices=Choices.model_validate({**self.choices.model_dump(), **values}))


def rig_key(rig: Rig) -> str:
    """Return a key for a pair of cameras, to be used in file names."""
    text = f"{rig.proximity.model} {rig.proximity.serial} {rig.tactile.model} {rig.tactile.serial}"
    text += f" {rig.proximity.intrinsics.shape} {rig.tactile.intrinsics.shape}"
    return hashlib.sha256(text.encode()).hexdigest()[:16]


DepthReader = Callable[[Snapshot, float, float], float | None]


class Session(History[SessionState]):
    """What the wizard's pages edit; every edit is one undoable step.

    Parameters
    ----------
    rig : Rig
    read_depth : callable
        Returns the tactile depth in metres at a pixel of a snapshot, or None.

    Signals
    -------
    selectionChanged(tuple of int)
        Other pairs are selected. Selecting is not an undo step.
    """

    selectionChanged = pyqtSignal(object)

    def __init__(self, rig: Rig, read_depth: DepthReader, parent: QObject | None = None) -> None:
        super().__init__(SessionState(), parent)
        self.rig = rig
        self._read_depth = read_depth
        self._selected: tuple[int, ...] = ()

    @property
    def selected(self) -> tuple[int, ...]:
        """Keys of the selected pairs."""
        return self._selected

    def pair(self, key: int) -> PointPair:
        """Return a pair by its key."""
        return next(pair for pair in self._state.pairs if pair.key == key)

    def show(self, state: SessionState) -> None:
        """Change the state without a step, and deselect pairs that no longer exist."""
        super().show(state)
        present = {pair.key for pair in state.pairs}
        self.select(key for key in self._selected if key in present)

    def select(self, keys: Iterable[int]) -> None:
        """Select pairs."""
        keys = tuple(keys)
        if keys != self._selected:
            self._selected = keys
            self.selectionChanged.emit(keys)

    def choose(self, text: str, gesture: int = 0, **values: Any) -> None:
        """Change choices, as one step with this text."""
        self.edit(text, self._state.with_choices(**values), gesture, tuple(values))

    def set_display(self, **values: Any) -> None:
        """Change what is displayed, without an undo step."""
        after = self._state.with_choices(**values)
        if after != self._state:
            self.show(after)

    # Snapshots

    def add_snapshot(self, snapshot: Snapshot) -> None:
        """Add a snapshot and click in it from now on."""
        if any(old.digest == snapshot.digest for old in self._state.snapshots):
            self.set_display(snapshot=snapshot.digest)
            return
        added = replace(self._state, snapshots=(*self._state.snapshots, snapshot))
        self.edit("Add a snapshot", added.with_choices(snapshot=snapshot.digest))

    def remove_snapshot(self, digest: str) -> None:
        """Remove a snapshot with the pairs clicked in it."""
        kept = tuple(snap for snap in self._state.snapshots if snap.digest != digest)
        pairs = tuple(pair for pair in self._state.pairs if pair.snapshot != digest)
        after = replace(self._state, snapshots=kept, pairs=pairs)
        if self._state.choices.snapshot == digest:
            after = after.with_choices(snapshot=kept[-1].digest if kept else "")
        self.edit("Remove a snapshot", after)

    # Pairs

    def click(self, side: Side, u: float, v: float) -> None:
        """Process a click: it starts a pair, moves its first click, or completes the pair."""
        pending, present = self._state.pending, self._state.choices.snapshot
        if pending is None or pending.snapshot != present:
            key = self._state.next_key() if pending is None else pending.key
            pair, text = PointPair(key=key, snapshot=present), f"Click point {key}"
        elif pending.place(side) is None:
            pair, text = pending, f"Complete pair {pending.key}"
        else:
            pair, text = pending, f"Click point {pending.key} elsewhere"
        pair = self._placed(pair, side, u, v)
        self.edit(text, self._state.with_pair(pair))
        self.select([pair.key])

    def move(self, key: int, side: Side, u: float, v: float, gesture: int = 0) -> None:
        """Move one side of a pair, keeping the image that it was clicked in."""
        moved = self._placed(self.pair(key), side, u, v, keep_image=True)
        self.edit(f"Move point {key}", self._state.with_pair(moved), gesture)

    def cancel_pending(self) -> None:
        """Remove a pending first click."""
        if self._state.pending is not None:
            self.remove([self._state.pending.key])

    def remove(self, keys: Iterable[int]) -> None:
        """Delete pairs."""
        gone = set(keys)
        kept = tuple(pair for pair in self._state.pairs if pair.key not in gone)
        self.edit(f"Delete {counted(len(self._state.pairs) - len(kept), 'pair')}", replace(self._state, pairs=kept))

    def enable(self, keys: Iterable[int], enabled: bool) -> None:
        """Switch pairs on or off."""
        chosen = set(keys)
        pairs = tuple(
            pair.model_copy(update={"enabled": enabled}) if pair.key in chosen else pair for pair in self._state.pairs
        )
        self.edit(
            f"Switch {counted(len(chosen), 'pair')} {'on' if enabled else 'off'}", replace(self._state, pairs=pairs)
        )

    def add_pairs(self, pairs: Iterable[PointPair], text: str) -> None:
        """Add complete pairs under new numbers, as one step."""
        first = self._state.next_key()
        added = tuple(pair.model_copy(update={"key": first + number}) for number, pair in enumerate(pairs))
        self.edit(text, replace(self._state, pairs=(*self._state.pairs, *added)))
        self.select([pair.key for pair in added])

    def _placed(self, pair: PointPair, side: Side, u: float, v: float, keep_image: bool = False) -> PointPair:
        values: dict[str, Any] = {side: (float(u), float(v))}
        if side == "proximity" and not keep_image:
            values["proximity_image"] = "color" if self._state.choices.proximity_image == "color" else "depth"
        if side == "tactile":
            snapshot = self._state.snapshot_of(pair)
            values["tactile_depth_m"] = self._read_depth(snapshot, u, v) if snapshot is not None else None
        return pair.model_copy(update=values)
