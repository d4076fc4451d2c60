"""The rig: the guided set-up and its steps, and the check for drift."""
