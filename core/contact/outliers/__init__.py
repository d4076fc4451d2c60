"""Removal of statistical outliers, Open3D's to the point, and of small clusters."""

from .clusters import in_large_cluster, pixel_areas_m2
from .rings import mean_neighbour_distances
from .statistical import statistical_inliers

__all__ = ["in_large_cluster", "mean_neighbour_distances", "pixel_areas_m2", "statistical_inliers"]
