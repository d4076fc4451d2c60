"""The calibration in progress: snapshots, point pairs and choices, all immutable, and their undoable edits."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict
from PyQt6.QtCore import QObject, pyqtSignal

from ...core.calibration.calibrate import ModelChoice
from ...core.calibration.snapshots import depth_under
from ...core.errors import counted
from ...core.model.alignment import PointPair, Side
from ...core.model.frames import Rig, SensorFrame
from ..document.document import History

ImageChoice = Literal["color", "depth"]
Target = Literal["texture", "chessboard"]

SIDES: tuple[Side, Side] = ("proximity", "tactile")


class Choices(BaseModel):
    """The options chosen on the pages; ``columns`` and ``rows`` count a chessboard's inner corners."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    snapshot: str = ""
    image: ImageChoice = "color"
    target: Target = "texture"
    columns: int = 9
    rows: int = 6
    model: ModelChoice = "auto"


@dataclass(frozen=True, eq=False)
class Snapshot:
    """One averaged frame; ``source`` names where it was taken, empty if unknown."""

    digest: str
    name: str
    frame: SensorFrame
    averaged: int = 1
    source: str = ""


@dataclass(frozen=True)
class SessionState:
    """Everything that undo restores. A pair names its snapshot by its place in ``snapshots``; imported ones may not."""

    snapshots: tuple[Snapshot, ...] = ()
    pairs: tuple[PointPair, ...] = ()
    choices: Choices = field(default_factory=Choices)

    @property
    def empty(self) -> bool:
        return not self.snapshots and not self.pairs

    @property
    def complete_pairs(self) -> tuple[PointPair, ...]:
        return tuple(pair for pair in self.pairs if pair.complete)

    @property
    def pending(self) -> PointPair | None:
        return next((pair for pair in self.pairs if not pair.complete), None)

    @property
    def digests(self) -> tuple[str, ...]:
        return tuple(snap.digest for snap in self.snapshots)

    @property
    def number(self) -> int | None:
        """The place of the snapshot that is being clicked in."""
        return self.digests.index(self.choices.snapshot) if self.choices.snapshot in self.digests else None

    @property
    def snapshot(self) -> Snapshot | None:
        return None if self.number is None else self.snapshots[self.number]

    @property
    def sources(self) -> tuple[str, ...]:
        """The sources that the snapshots were taken from, each once; unknown ones are left out."""
        return tuple(dict.fromkeys(snap.source for snap in self.snapshots if snap.source))

    def snapshot_of(self, pair: PointPair) -> Snapshot | None:
        known = pair.snapshot is not None and pair.snapshot < len(self.snapshots)
        return self.snapshots[pair.snapshot] if known and pair.snapshot is not None else None

    def next_id(self) -> int:
        return max((int(pair.id) for pair in self.pairs), default=0) + 1

    def with_pair(self, pair: PointPair) -> SessionState:
        if any(old.id == pair.id for old in self.pairs):
            return replace(self, pairs=tuple(pair if old.id == pair.id else old for old in self.pairs))
        return replace(self, pairs=(*self.pairs, pair))

    def with_choices(self, **values: object) -> SessionState:
        return replace(self, choices=Choices.model_validate({**self.choices.model_dump(), **values}))


def renumbered(pairs: Iterable[PointPair], before: Sequence[str], after: Sequence[str]) -> tuple[PointPair, ...]:
    """Return pairs that refer to other snapshots, given by their digests; None where theirs is gone."""
    numbers = {number: after.index(digest) if digest in after else None for number, digest in enumerate(before)}
    return tuple(
        pair if pair.snapshot is None else pair.model_copy(update={"snapshot": numbers.get(pair.snapshot)})
        for pair in pairs
    )


def tactile_depth(frame: SensorFrame, rig: Rig, u: float, v: float) -> float | None:
    """Return the raw tactile depth in metres at a pixel, from its neighbourhood; None without depth."""
    return depth_under(frame.tactile_depth, rig.tactile.depth_unit_m, u, v)


def rig_key(rig: Rig) -> str:
    """Return a key for a pair of cameras, to be used in file names."""
    text = f"{rig.proximity.model} {rig.proximity.serial} {rig.tactile.model} {rig.tactile.serial}"
    text += f" {rig.proximity.intrinsics.shape} {rig.tactile.intrinsics.shape}"
    return hashlib.sha256(text.encode()).hexdigest()[:16]


class Session(History[SessionState]):
    """What the wizard's pages edit; every edit is one undoable step."""

    selectionChanged = pyqtSignal(object)  # ids; selecting is not an undo step

    def __init__(self, rig: Rig, parent: QObject | None = None) -> None:
        super().__init__(SessionState(), parent)
        self.rig = rig
        self.selected: tuple[str, ...] = ()  # ids of pairs

    def pair(self, name: str) -> PointPair:
        return next(pair for pair in self.state.pairs if pair.id == name)

    def show(self, state: SessionState) -> None:
        """Change the state without a step, and deselect pairs that no longer exist."""
        super().show(state)
        present = {pair.id for pair in state.pairs}
        self.select(name for name in self.selected if name in present)

    def select(self, names: Iterable[str]) -> None:
        names = tuple(names)
        if names != self.selected:
            self.selected = names
            self.selectionChanged.emit(names)

    def choose(self, text: str, gesture: int = 0, **values: Any) -> None:
        self.edit(text, self.state.with_choices(**values), gesture, tuple(values))

    def set_display(self, **values: Any) -> None:
        after = self.state.with_choices(**values)
        if after != self.state:
            self.show(after)

    def add_snapshot(self, snapshot: Snapshot) -> None:
        """Add a snapshot and click in it from now on."""
        if snapshot.digest in self.state.digests:
            self.set_display(snapshot=snapshot.digest)
            return
        added = replace(self.state, snapshots=(*self.state.snapshots, snapshot))
        self.edit("Add a snapshot", added.with_choices(snapshot=snapshot.digest))

    def remove_snapshot(self, digest: str) -> None:
        before = self.state
        kept = tuple(snap for snap in before.snapshots if snap.digest != digest)
        pairs = [pair for pair in before.pairs if pair.snapshot != before.digests.index(digest)]
        after = replace(before, snapshots=kept)
        after = replace(after, pairs=renumbered(pairs, before.digests, after.digests))
        if before.choices.snapshot == digest:
            after = after.with_choices(snapshot=kept[-1].digest if kept else "")
        self.edit("Remove a snapshot", after)

    def click(self, side: Side, u: float, v: float) -> None:
        """Process a click: it starts a pair, moves its first click, or completes the pair."""
        pending, present = self.state.pending, self.state.number
        if pending is None or pending.snapshot != present:
            name = str(self.state.next_id()) if pending is None else pending.id
            pair, text = PointPair(id=name, snapshot=present, origin="clicked"), f"Click point {name}"
        elif pending.place(side) is None:
            pair, text = pending, f"Complete pair {pending.id}"
        else:
            pair, text = pending, f"Click point {pending.id} elsewhere"
        self.edit(text, self.state.with_pair(self._placed(pair, side, u, v)))
        self.select([pair.id])

    def move(self, name: str, side: Side, u: float, v: float, gesture: int = 0) -> None:
        """Move one side of a pair, keeping the image that it was clicked in."""
        moved = self._placed(self.pair(name), side, u, v, keep_image=True)
        self.edit(f"Move point {name}", self.state.with_pair(moved), gesture)

    def cancel_pending(self) -> None:
        if self.state.pending is not None:
            self.remove([self.state.pending.id])

    def remove(self, names: Iterable[str]) -> None:
        gone = set(names)
        kept = tuple(pair for pair in self.state.pairs if pair.id not in gone)
        self.edit(f"Delete {counted(len(self.state.pairs) - len(kept), 'pair')}", replace(self.state, pairs=kept))

    def enable(self, name: str, enabled: bool) -> None:
        switched = self.pair(name).model_copy(update={"enabled": enabled})
        self.edit(f"Switch pair {name} {'on' if enabled else 'off'}", self.state.with_pair(switched))

    def add_pairs(self, pairs: Iterable[PointPair], text: str) -> None:
        """Add complete pairs under new numbers, as one step."""
        first = self.state.next_id()
        added = tuple(pair.model_copy(update={"id": str(first + number)}) for number, pair in enumerate(pairs))
        self.edit(text, replace(self.state, pairs=(*self.state.pairs, *added)))
        self.select([pair.id for pair in added])

    def _placed(self, pair: PointPair, side: Side, u: float, v: float, keep_image: bool = False) -> PointPair:
        values: dict[str, Any] = {f"{side}_u": float(u), f"{side}_v": float(v)}
        if side == "proximity" and not keep_image:
            values["proximity_image"] = self.state.choices.image
        if side == "tactile":
            snapshot = self.state.snapshot_of(pair)
            values["tactile_depth_m"] = None if snapshot is None else tactile_depth(snapshot.frame, self.rig, u, v)
        return pair.model_copy(update=values)
