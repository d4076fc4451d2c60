"""Small parts that all widgets share: theme, colour maps, buttons, labels, tables."""
