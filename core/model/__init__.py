"""The data that flows through the pipeline: frames, the rig and its file, lenses, clouds, patches."""
