"""Live cameras of any maker, captured in a separate process.

`camera` is the interface that a maker's driver implements, `realsense` the driver of our own; `pairing` pairs the
images of both cameras by time, `camera_thread` runs a camera and opens it again, `camera_source` makes frames of pairs.
"""
