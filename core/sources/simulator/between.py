"""A state of a scene between two solved ones, by interpolation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any, Final

import cv2
import numpy as np

from ...model.arrays import AnyArray, Uint16Array
from ...model.frames import Matrix4, rigid_transform
from .render import CLEAN_UNIT_M
from .scene import CleanState, PressFacts

#: Where a depth changes by more between two states, an outline has passed; metres.
_OUTLINE_M: Final = 0.003


def state_between(states: Sequence[CleanState], place: float) -> CleanState:
    """Return the images of a place in a sequence of states, 0 to ``len(states) - 1``.

    Depth and colours are interpolated linearly. Flags and angles of incidence, and depth where an outline has passed,
    are those of the nearer state.
    """
    first, share = _divide(place, len(states))
    if share == 0.0:
        return states[first]
    a, b = states[first], states[first + 1]
    near = a if share < 0.5 else b

    def mixed(name: str) -> Any:
        return cv2.addWeighted(getattr(a, name), 1.0 - share, getattr(b, name), share, 0.0)

    def depth(name: str) -> Uint16Array:
        image: AnyArray = mixed(name)
        passed = cv2.absdiff(getattr(a, name), getattr(b, name)) > _OUTLINE_M / CLEAN_UNIT_M
        np.copyto(image, getattr(near, name), where=passed)
        return image

    return replace(
        near,
        behind=depth("behind"),
        membrane=depth("membrane"),
        tactile=depth("tactile"),
        proximity_color=mixed("proximity_color"),
        tactile_color=mixed("tactile_color"),
    )


def facts_between(facts: Sequence[PressFacts], place: float) -> PressFacts:
    """Return the facts of a place in a sequence of states; the object turns about one axis from state to state."""
    first, share = _divide(place, len(facts))
    if share == 0.0:
        return facts[first]
    a, b = facts[first], facts[first + 1]
    mixed: dict[str, Any] = {
        field.name: (1.0 - share) * np.asarray(getattr(a, field.name)) + share * np.asarray(getattr(b, field.name))
        for field in fields(PressFacts)
    }
    mixed = {name: value.item() if value.ndim == 0 else tuple(value.tolist()) for name, value in mixed.items()}
    mixed["T_proximity_object"] = _pose_between(a, b, share)
    return PressFacts(**mixed)


def _divide(place: float, count: int) -> tuple[int, float]:
    """Return the state before a place and the share of the way to the next one."""
    first = min(int(place), count - 1)
    return first, place - first


def _pose_between(a: PressFacts, b: PressFacts, share: float) -> Matrix4:
    before, after = np.array(a.T_proximity_object), np.array(b.T_proximity_object)
    axis_angle = cv2.Rodrigues(before[:3, :3].T @ after[:3, :3])[0]
    pose = (1.0 - share) * before + share * after
    pose[:3, :3] = before[:3, :3] @ cv2.Rodrigues(share * axis_angle)[0]
    return rigid_transform(pose)
