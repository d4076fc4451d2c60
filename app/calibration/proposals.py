"""Points that a helper finds: boards, dot grids, the membrane's texture. The person accepts or refuses them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from ...core.calibration.detect import Detection, detect_charuco, detect_chessboard, detect_circles, match_detections
from ...core.calibration.texture import match_texture
from ...core.errors import CalibrationError
from ...core.model.frames import Rig
from ..worker.jobs import Progress
from .pictures import Picture, picture, tactile_depth_at
from .state import Choices, PointPair, Snapshot


class Helper(StrEnum):
    """What to look for."""

    TEXTURE = "Membrane texture"
    CHESSBOARD = "Chessboard"
    CHARUCO = "ChArUco board"
    CIRCLES = "Asymmetric circles"
    DOTS = "Dot grid"


@dataclass(frozen=True)
class HelperOptions:
    """Size of the target; see `tactune.core.calibration.detect`."""

    helper: Helper = Helper.TEXTURE
    columns: int = 9
    rows: int = 6
    marker_share: float = 0.7
    dictionary: str = "DICT_4X4_250"


@dataclass(frozen=True)
class Proposals:
    """What was found, and what was not, in words."""

    pairs: tuple[PointPair, ...]
    words: str


def find_proposals(
    options: HelperOptions, snapshots: Sequence[Snapshot], choices: Choices, rig: Rig, progress: Progress
) -> Proposals:
    """Look for points in every snapshot.

    Raises
    ------
    CalibrationError
        Nothing was found in any of them; the message is that of the last one.
    """
    if options.helper is Helper.TEXTURE:
        return _texture(snapshots, rig, progress)
    found: list[PointPair] = []
    problems: list[str] = []
    for number, snapshot in enumerate(snapshots):
        progress(number / len(snapshots), f"Looking in {snapshot.name}")
        try:
            found += _pairs(options, snapshot, choices, rig)
        except CalibrationError as error:
            problems.append(f"{snapshot.name}: {error}")
    if not found:
        raise CalibrationError(problems[-1] if problems else "no snapshot yet: take one on the page Frames")
    pairs = tuple(pair.model_copy(update={"key": number + 1}) for number, pair in enumerate(found))
    words = f"{len(pairs)} pairs were found in {_snapshots(len(snapshots))}."
    return Proposals(pairs, " ".join([words, *(f"Not in {problem}." for problem in problems)]))


def _texture(snapshots: Sequence[Snapshot], rig: Rig, progress: Progress) -> Proposals:
    for snapshot in snapshots:
        if snapshot.frame.tactile_color is None:
            raise CalibrationError(
                f"{snapshot.name}: there is no tactile colour image, so no texture to match; "
                "detect a target or click the points"
            )
    progress(0.1, f"Matching droplets in {_snapshots(len(snapshots))}")
    matches = match_texture([snapshot.frame for snapshot in snapshots], rig)
    pairs = tuple(
        PointPair(
            key=number + 1,
            proximity=match.proximity,
            tactile=match.tactile,
            tactile_depth_m=match.tactile_depth_m,
            proximity_image=match.proximity_image,
            snapshot=snapshots[match.snapshot or 0].digest,
            origin=f"texture, likeness {likeness:.2f}",
        )
        for number, (match, likeness) in enumerate(zip(matches.pairs, matches.likeness, strict=True))
    )
    return Proposals(
        pairs,
        f"{len(pairs)} droplets were found again in {_snapshots(len(snapshots))}; together they fit a rigid pose "
        f"to {matches.fit.rms_px:.2f} px.",
    )


def _snapshots(count: int) -> str:
    return "one snapshot" if count == 1 else f"{count} snapshots"


def _pairs(options: HelperOptions, snapshot: Snapshot, choices: Choices, rig: Rig) -> list[PointPair]:
    frame = snapshot.frame
    sides = (
        picture(frame, rig, "proximity", choices.proximity_image, stretch=True),
        picture(frame, rig, "tactile", choices.tactile_image, stretch=True),
    )
    proximity, tactile = (_detect(options, side) for side in sides)
    return [
        PointPair(
            key=0,
            proximity=(float(left[0]), float(left[1])),
            tactile=(float(right[0]), float(right[1])),
            tactile_depth_m=tactile_depth_at(frame, rig, float(right[0]), float(right[1])),
            proximity_image="color" if choices.proximity_image == "color" else "depth",
            snapshot=snapshot.digest,
            origin=f"{options.helper.value.lower()} {name}",
        )
        for name, left, right in match_detections(proximity, tactile)
    ]


def _detect(options: HelperOptions, side: Picture) -> Detection:
    if options.helper is Helper.CHESSBOARD:
        return detect_chessboard(side.gray, options.columns, options.rows)
    if options.helper is Helper.CHARUCO:
        return detect_charuco(side.gray, options.columns, options.rows, options.marker_share, options.dictionary)
    return detect_circles(side.gray, options.columns, options.rows, asymmetric=options.helper is Helper.CIRCLES)
