"""The live simulator: a membrane pressed by an object, seen by two noisy cameras, with ground truth."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..base import FrameSource, Progress, SourceKind

if TYPE_CHECKING:
    from ...preset import CamerasSection


def _open(rest: str, progress: Progress | None, cameras: CamerasSection | None) -> FrameSource:
    from .names import read_name, source_options  # not above: it compiles kernels' modules
    from .source import SimulatorSource

    return SimulatorSource(progress=progress, **source_options(read_name(rest)))


KIND = SourceKind(
    scheme="sim",
    title="Simulator",
    form="sim:SCENE[?press=medium&membrane=NAME&sensor=NAME&seed=N&noise=X]",
    description=(
        "A simulated sensor with ground truth, pressed by an object: cube, cup, octopus; mug and hand, held out for "
        "judging methods; tray rolls. press=low, medium or high holds a press, high at side=right or left, press=none "
        "shows the untouched membrane; gap=5 holds the object 5 mm away; move=slide turns and slides an object across "
        "folds for 5 s; grid=dots prints dots 10 mm apart; "
        "noise=0, 1 or 2 times the errors of sensor=l515-d405. A wrong membrane= or sensor= lists all."
    ),
    needs="nothing",
    examples=("sim:cube", "sim:cup", "sim:octopus"),
    open=_open,
)
