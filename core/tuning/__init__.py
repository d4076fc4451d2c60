"""The search for good preset values: its plan, how a trial is measured, the workers, and the study of all trials."""
