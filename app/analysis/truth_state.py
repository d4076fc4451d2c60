"""What a person does to lay a scan over a patch: an immutable state, every edit one undoable step."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import numpy.typing as npt
from PyQt6.QtCore import QObject, pyqtSignal

from ...core.errors import CalibrationError
from ...core.model.arrays import Float64Array
from ...core.model.frames import Matrix4, rigid_transform
from ...core.scan.paint import PaintSettings
from ...core.scan.pose import pose_from_pairs
from ..document.history import History
from .truth_patch import FrozenPatch

Place = tuple[float, float, float]
Side = Literal["scan", "patch"]
#: Where a pose comes from.
Origin = Literal["", "pairs", "hand", "ICP", "file"]

LEAST_PAIRS = 3


@dataclass(frozen=True)
class PickedPair:
    """The same point on the scan, in its own frame, and on the patch, in the proximity frame; metres."""

    scan: Place | None = None
    patch: Place | None = None

    @property
    def complete(self) -> bool:
        """Whether both sides are clicked."""
        return self.scan is not None and self.patch is not None


@dataclass(frozen=True)
class TruthState:
    """All that is undone, redone and kept for one scan.

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
        """Whether nothing was done yet."""
        return self == TruthState()

    @property
    def matched(self) -> tuple[list[Place], list[Place]]:
        """Both sides of the complete pairs: on the scan, on the patch."""
        both = [(pair.scan, pair.patch) for pair in self.pairs if pair.scan is not None and pair.patch is not None]
        return [scan for scan, _ in both], [patch for _, patch in both]

    @property
    def pending(self) -> PickedPair | None:
        """The pair that waits for its other side; only ever the last one."""
        return self.pairs[-1] if self.pairs and not self.pairs[-1].complete else None


class TruthSession(History[TruthState]):
    """What the ground-truth tab edits; every edit is one undoable step.

    Signals
    -------
    refused(sentence: str)
        An edit was made, yet no pose came of it; empty once one does.
    """

    refused = pyqtSignal(str)

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(TruthState(), parent)

    def set_paint(self, paint: PaintSettings, gesture: int = 0) -> None:
        """Take other colours or another clean-up."""
        self.edit("Change the paint's colours", replace(self._state, paint=paint), gesture)

    def freeze(self, patch: FrozenPatch | None) -> None:
        """Align to this patch from now on; None: follow the main window again."""
        text = "Follow the main window" if patch is None else f"Align to {patch.title}"
        self.edit(text, replace(self._state, patch=patch))

    def click(self, side: Side, place: Place, patch: FrozenPatch | None) -> None:
        """Take a click: it begins a pair, moves its first click, or completes it, which fits the pose."""
        state = self._held(patch)
        pending = state.pending
        pair = replace(pending or PickedPair(), **{side: place})
        pairs = (*(state.pairs[:-1] if pending else state.pairs), pair)
        self._edit_pairs(f"Click point {len(pairs)}", replace(state, pairs=pairs))

    def remove(self, number: int) -> None:
        """Delete a pair by its place in the list."""
        pairs = tuple(pair for at, pair in enumerate(self._state.pairs) if at != number)
        self._edit_pairs(f"Delete pair {number + 1}", replace(self._state, pairs=pairs))

    def remove_all(self) -> None:
        """Delete all pairs; the pose stays."""
        self.edit("Delete all pairs", replace(self._state, pairs=()))

    def set_pose(
        self, pose: npt.ArrayLike, origin: Origin, text: str, patch: FrozenPatch | None, gesture: int = 0
    ) -> None:
        """Take another pose; ``patch`` is held fast where none is yet."""
        try:
            rigid = rigid_transform(pose)
        except ValueError as error:
            self.refused.emit(f"The scan stays where it is: {error}.")
            return
        self.refused.emit("")
        self.edit(text, replace(self._held(patch), pose=rigid, origin=origin), gesture)

    def nudge(self, change: Float64Array, patch: FrozenPatch | None, gesture: int) -> None:
        """Move and turn the scan by a transform of the proximity frame; ``patch`` as for `set_pose`."""
        if self._state.pose is None:
            return
        pose = change @ np.asarray(self._state.pose)
        left, _, right = np.linalg.svd(pose[:3, :3])
        pose[:3, :3] = left @ right  # many small turns must not add up to something that is no rotation
        self.set_pose(pose, "hand", "Nudge the scan", patch, gesture)

    def _held(self, patch: FrozenPatch | None) -> TruthState:
        return self._state if self._state.patch is not None else replace(self._state, patch=patch)

    def _edit_pairs(self, text: str, after: TruthState) -> None:
        """Take other pairs; where there are enough of them, they say the pose."""
        matched, sentence = after.matched, ""
        if len(matched[0]) >= LEAST_PAIRS and matched != self._state.matched:
            try:
                pose = pose_from_pairs(*matched)
                after = replace(after, pose=pose, origin="pairs")
            except CalibrationError as error:
                sentence = f"No pose from these pairs: {error}."
        self.edit(text, after)
        self.refused.emit(sentence)
