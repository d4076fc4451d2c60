"""From a frame to its contact patch: alignment, contact tests, outlier removal."""
