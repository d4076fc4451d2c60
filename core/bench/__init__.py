"""Run time against error: engines, scenes, and the driver that measures them side by side.

An engine is one way to do a job; each registers itself under a name with `engine` and is measured
on the same frames as all others, in one run, in turns.
"""
