"""The search for good preset values: space, measurement of trials, workers, and the study that keeps all trials."""
