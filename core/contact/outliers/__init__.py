"""Removal of statistical outliers, Open3D's to the point, and of small clusters."""

from .clusters import in_large_cluster
from .rings import mean_neighbour_distances
from .statistical import statistical_inliers

__all__ = ["in_large_cluster", "mean_neighbour_distances", "statistical_inliers"]
