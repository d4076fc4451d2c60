"""Faster answers with a known error: other outlier rules, and pipelines on fewer pixels."""

from __future__ import annotations

from dataclasses import replace

from ...contact.outliers.variants import strided_inliers, voxel_inliers, windowed_inliers
from ...contact.pipeline import ContactPipeline
from ...model.arrays import BoolArray
from ...model.frames import DepthCamera, Rig, SensorFrame
from ..registry import Job, Outcome, Runner, engine
from ..scenes import BenchScene
from .tactune import pipeline_runner


@engine("tactune-windowed", Job.PIPELINE, "Tactune, neighbours in a fixed window", exact=False)
def windowed(scene: BenchScene) -> Runner:
    """The k nearest within a window of about 4 k pixels."""
    return pipeline_runner(scene, inliers=windowed_inliers)


@engine("tactune-strided", Job.PIPELINE, "Tactune, every second neighbour", exact=False)
def strided(scene: BenchScene) -> Runner:
    """The k / 4 nearest among every second row and column."""
    return pipeline_runner(scene, inliers=strided_inliers)


@engine("tactune-voxel", Job.PIPELINE, "Tactune, one point a voxel judged", exact=False)
def voxel(scene: BenchScene) -> Runner:
    """One point for each cube of two pixels' width."""
    return pipeline_runner(scene, inliers=voxel_inliers)


@engine("tactune-no-outliers", Job.PIPELINE, "Tactune, no outlier removal", exact=False)
def no_outliers(scene: BenchScene) -> Runner:
    """Clusters only."""
    return pipeline_runner(scene, {"outliers.enabled": False})


@engine("tactune-half", Job.PIPELINE, "Tactune, every second row and column", exact=False)
def half_resolution(scene: BenchScene) -> Runner:
    """The whole pipeline on a quarter of the pixels, its mask spread over all."""
    rig = Rig(
        proximity=_every_second(scene.rig.proximity),
        tactile=_every_second(scene.rig.tactile),
        proximity_color=scene.rig.proximity_color,
        T_proximity_tactile=scene.rig.T_proximity_tactile,
    )
    frame = replace(scene.frame, truth=None)
    preset = scene.preset.with_values({"rig": None, "outliers.k": max(2, round(scene.preset.outliers.k / 4))})
    pipeline = ContactPipeline(preset, rig)
    shape = frame.proximity_depth.shape
    own_color = rig.proximity_color is None

    def smaller() -> SensorFrame:
        return SensorFrame(
            frame.sequence,
            frame.proximity_depth[::2, ::2],
            frame.tactile_depth[::2, ::2],
            frame.proximity_color[::2, ::2] if own_color else frame.proximity_color,
        )

    def run() -> Outcome:
        patch = pipeline.process(smaller())
        return Outcome(lambda: _spread(patch.mask, shape), patch.points)

    return run


def _every_second(camera: DepthCamera) -> DepthCamera:
    lens = camera.intrinsics
    update = {
        "width": (lens.width + 1) // 2, "height": (lens.height + 1) // 2, "fx": lens.fx / 2, "fy": lens.fy / 2,
        "cx": lens.cx / 2, "cy": lens.cy / 2,
    }  # fmt: skip
    return camera.model_copy(update={"intrinsics": lens.model_copy(update=update)})


def _spread(mask: BoolArray, shape: tuple[int, ...]) -> BoolArray:
    return mask.repeat(2, axis=0).repeat(2, axis=1)[: shape[0], : shape[1]]
