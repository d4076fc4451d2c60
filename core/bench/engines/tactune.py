"""Tactune's pipeline and its stages, called as a robot program calls them."""

from __future__ import annotations

from dataclasses import replace
from itertools import cycle
from typing import Any

import numpy as np

from ...contact.outliers.statistical import NeighbourMemory, statistical_inliers
from ...contact.pipeline import ContactPipeline
from ..registry import Job, Outcome, Runner, engine
from ..scenes import BenchScene
from .reference import candidate_points, mask_of


def _pipeline_runner(scene: BenchScene, values: dict[str, Any]) -> Runner:
    """Return a runner of the pipeline with changed preset values.

    Two frame objects alternate, because the pipeline caches the results of the last frame.
    """
    pipeline = ContactPipeline(scene.preset.with_values(values), scene.rig)
    frames = cycle((scene.frame, replace(scene.frame)))

    def run() -> Outcome:
        patch = pipeline.process(next(frames))
        return Outcome(lambda: patch.mask, patch.points)

    return run


@engine("tactune", Job.PIPELINE, "Tactune, exact")
def whole_pipeline(scene: BenchScene) -> Runner:
    """The whole pipeline."""
    return _pipeline_runner(scene, {})


@engine("tactune-per-pixel", Job.PER_PIXEL, "Tactune, per-pixel chain")
def per_pixel(scene: BenchScene) -> Runner:
    """Without outlier removal and clusters."""
    return _pipeline_runner(scene, {"outliers.enabled": False, "outliers.min_cluster_area_mm2": 0.0})


@engine("tactune-no-outliers", Job.PIPELINE, "Tactune, no outlier removal", exact=False)
def no_outliers(scene: BenchScene) -> Runner:
    """With clusters but without outlier removal."""
    return _pipeline_runner(scene, {"outliers.enabled": False})


@engine("tactune-outliers", Job.OUTLIERS, "Tactune, organised search, exact")
def outliers(scene: BenchScene) -> Runner:
    """Outlier removal by search in the image grid."""
    exact_points, pixels = candidate_points(scene)
    section, intrinsics = scene.preset.outliers, scene.rig.proximity.intrinsics
    points = exact_points.astype(np.float32)
    memory, clouds = NeighbourMemory(), cycle((points, points.copy()))  # two arrays: the results of one are remembered

    def run() -> Outcome:
        kept = statistical_inliers(next(clouds), pixels, intrinsics, section.k, section.ratio, memory)
        return Outcome(lambda: mask_of(scene, pixels[kept]))

    return run


@engine("copy-depths", Job.PIPELINE, "Copying both depth images", exact=False)
def copy_depths(scene: BenchScene) -> Runner:
    """Copy the images only; finds nothing."""
    images = scene.frame.proximity_depth, scene.frame.tactile_depth
    targets = [np.empty_like(image) for image in images]
    nothing = np.zeros(images[0].shape, bool)

    def run() -> Outcome:
        for target, image in zip(targets, images, strict=True):
            np.copyto(target, image)
        return Outcome(lambda: nothing)

    return run
