"""Names of the simulator's scenes and of their options, without the code that computes them."""

SCENES = ("cube", "cup", "octopus")
#: Further scenes, and the options of all scenes.
MORE_SCENES = ("two", "knobs", "star", "tray", "mug", "hand", "hover", "stiff", "wrinkled", "slide")
SCENE_OPTIONS = ("press", "move", "side", "object", "gap", "membrane", "grid", "light", "sensor", "seed", "noise")
DEFAULT_SCENE = "cup"
