"""Names of the simulator's scenes and of their options, without the code that computes them."""

SCENES = ("cube", "cup", "octopus")
#: Further scenes, and the options of all scenes.
MORE_SCENES = ("tray", "mug", "hand", "hover")
SCENE_OPTIONS = ("press", "move", "side", "object", "gap", "membrane", "grid", "light", "sensor", "seed", "noise")
DEFAULT_SCENE = "cup"
