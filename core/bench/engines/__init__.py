"""One file for each family of engines; see `tactune.core.bench.registry`."""
