"""Live cameras of any maker, captured in a separate process.

`camera` is the interface that a maker's driver implements, `realsense` the driver of our own; `pairing` pairs the
images of both cameras by time, `source` runs the cameras and makes frames of the pairs.
"""
