"""Run time against error: engines, scenes, and the driver that measures them side by side.

An engine is one way to do a job. Each registers itself with `registry.engine` under a name. All engines are measured
on the same frames, in one run, in turns.
"""
