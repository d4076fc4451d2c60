"""The checks of ``tactune doctor``: none needs Qt, so that a headless machine can be checked."""
