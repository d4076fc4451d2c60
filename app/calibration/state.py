"""What a calibration consists of while it is being made: snapshots, pairs of points, choices. All immutable."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace
from typing import Literal

from pydantic import BaseModel, ConfigDict

from ...core.model.frames import Rig, SensorFrame

Side = Literal["proximity", "tactile"]
ProximityImage = Literal["color", "depth"]
ImageChoice = Literal["color", "depth", "relative"]
ModelChoice = Literal["auto", "rigid", "homography"]
Place = tuple[float, float]

SIDES: tuple[Side, Side] = ("proximity", "tactile")


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class PointPair(_Frozen):
    """The same thing clicked in both images; while one side is missing, the pair waits for its partner.

    ``proximity_image`` tells in whose pixels the proximity side is; ``tactile_depth_m`` is None where the
    tactile camera has no depth there. ``snapshot`` is a digest, empty for imported pairs.
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
        """Whether both sides are there."""
        return self.proximity is not None and self.tactile is not None

    def place(self, side: Side) -> Place | None:
        """Return one side."""
        return self.proximity if side == "proximity" else self.tactile


class Choices(_Frozen):
    """What the person chose on the pages."""

    snapshot: str = ""
    proximity_image: ImageChoice = "color"
    tactile_image: ImageChoice = "color"
    stretch: bool = True
    snap: bool = True
    average: int = 10
    model: ModelChoice = "auto"
    fit_depth: bool = False


@dataclass(frozen=True, eq=False)
class Snapshot:
    """One averaged frame; ``moved_m`` is how far the membrane moved meanwhile."""

    digest: str
    name: str
    frame: SensorFrame
    averaged: int = 1
    moved_m: float = 0.0


@dataclass(frozen=True)
class SessionState:
    """Everything that undo brings back."""

    snapshots: tuple[Snapshot, ...] = ()
    pairs: tuple[PointPair, ...] = ()
    choices: Choices = field(default_factory=Choices)

    @property
    def empty(self) -> bool:
        """Whether nothing has been done yet."""
        return not self.snapshots and not self.pairs

    @property
    def complete_pairs(self) -> tuple[PointPair, ...]:
        """Pairs with both sides."""
        return tuple(pair for pair in self.pairs if pair.complete)

    @property
    def pending(self) -> PointPair | None:
        """The pair that waits for its partner."""
        return next((pair for pair in self.pairs if not pair.complete), None)

    @property
    def snapshot(self) -> Snapshot | None:
        """The snapshot that is being clicked in."""
        chosen = self.choices.snapshot
        return next((snap for snap in self.snapshots if snap.digest == chosen), None)

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
    """Return a name for a pair of cameras that serves as part of a file name."""
    text = f"{rig.proximity.model} {rig.proximity.serial} {rig.tactile.model} {rig.tactile.serial}"
    text += f" {rig.proximity.intrinsics.shape} {rig.tactile.intrinsics.shape}"
    return hashlib.sha256(text.encode()).hexdigest()[:16]
