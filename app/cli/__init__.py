"""The command ``tactune``: `main` and one file per group of commands; `common` is what they share."""
