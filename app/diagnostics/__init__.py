"""Are the cameras and this computer well? The window that checks the cameras, and the checks of ``tactune doctor``.

The modules whose names begin with ``doctor`` need no Qt, so that a headless machine can be checked, too.
"""
