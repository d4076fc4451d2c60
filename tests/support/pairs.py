"""Point pairs of a calibration that are known exactly."""

from __future__ import annotations

import numpy as np

from tactune.app.calibration.session import PointPair, SessionState
from tactune.app.calibration.snapshots import take_snapshot


def snapshot_of(frame, feed):
    return take_snapshot([frame], frame.sequence + 1, feed.info, lambda share, words: None)


def with_pairs(scene, frames, feed, dots=range(0, 63, 5)):
    """A state with exact pairs on both levels."""
    snapshots = tuple(snapshot_of(frames[level], feed) for level in (0.2, 1.0))
    pairs = []
    for snapshot, level in zip(snapshots, (0.2, 1.0), strict=True):
        T = np.linalg.inv(scene.T_p_t)
        depths = (scene.points(level) @ T[:3, :3].T + T[:3, 3])[:, 2]
        for dot in dots:
            pairs.append(
                PointPair(
                    key=len(pairs) + 1,
                    proximity=tuple(scene.proximity_pixels(level)[dot].tolist()),
                    tactile=tuple(scene.tactile_pixels(level)[dot].tolist()),
                    tactile_depth_m=float(depths[dot]),
                    snapshot=snapshot.digest,
                )
            )
    return SessionState(snapshots, tuple(pairs)).with_choices(snapshot=snapshots[1].digest)
