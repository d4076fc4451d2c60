"""Point pairs of a calibration that are known exactly."""

from __future__ import annotations

import numpy as np

from tactune.app.calibration.session import SessionState
from tactune.app.calibration.snapshots import take_snapshot
from tactune.core.model.alignment import PointPair


def snapshot_of(frame, feed):
    return take_snapshot([frame], frame.sequence + 1, feed.info)


def with_pairs(scene, frames, feed, dots=range(0, 63, 5)):
    """A state with exact pairs on both levels."""
    snapshots = tuple(snapshot_of(frames[level], feed) for level in (0.2, 1.0))
    pairs = []
    for number, level in enumerate((0.2, 1.0)):
        T = np.linalg.inv(scene.T_p_t)
        depths = (scene.points(level) @ T[:3, :3].T + T[:3, 3])[:, 2]
        for dot in dots:
            pairs.append(
                pair_at(
                    len(pairs) + 1,
                    scene.proximity_pixels(level)[dot],
                    scene.tactile_pixels(level)[dot],
                    tactile_depth_m=float(depths[dot]),
                    snapshot=number,
                )
            )
    return SessionState(snapshots, tuple(pairs)).with_choices(snapshot=snapshots[1].digest)


def pair_at(name, proximity, tactile, **values):
    """A pair clicked in colour."""
    (proximity_u, proximity_v), (tactile_u, tactile_v) = (map(float, place) for place in (proximity, tactile))
    return PointPair(
        id=str(name), proximity_u=proximity_u, proximity_v=proximity_v, tactile_u=tactile_u, tactile_v=tactile_v,
        **{"proximity_image": "color", "origin": "clicked"} | values,
    )  # fmt: skip


def moved(pair, du, dv):
    """The pair with its proximity click elsewhere."""
    return pair.model_copy(update={"proximity_u": pair.proximity_u + du, "proximity_v": pair.proximity_v + dv})
