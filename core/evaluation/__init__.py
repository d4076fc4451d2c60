"""Ground truth and the metrics that compare a patch with it."""
