"""Removal of statistical outliers, with the same inliers as Open3D, and of small clusters."""
