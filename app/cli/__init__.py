"""The command ``tactune``: one file for each command."""
