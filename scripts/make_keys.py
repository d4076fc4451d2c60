"""Write docs/guide/keys.md from the window's table of actions; a test compares the two.

.venv/bin/python scripts/make_keys.py
"""

from pathlib import Path

from tactune.app.analysis.window import OWN_TABS
from tactune.app.window.actions import TABLE, Row

MOUSE = (
    ("Drag in a view", "orbit all views"),
    ("Shift + drag, middle button", "pan"),
    ("Wheel", "zoom, in views and images"),
    ("Double click in a view or image", "swap it with the patch, or go back"),
    ("Drag the line between A and B", "move the wipe while presets are compared"),
    ("Click or drag in the time strip", "seek"),
    ("Eyedropper, then click in the colour image", "set the mask to the prints' colour"),
    ("Drop a file or folder", "open a preset or a recording"),
)
PAGE = Path(__file__).resolve().parent.parent / "docs" / "guide" / "keys.md"


def page() -> str:
    """Return the page: each menu's actions that have keys, then the mouse."""
    lines = ["# Keys and mouse", "", "*Help > Shortcuts* (Shift+F1) opens this page."]
    for title, entries in TABLE.items():
        rows = [(row, row.keys or row.text.partition("\t")[2]) for row in entries if isinstance(row, Row)]
        if any(keys for _, keys in rows):
            lines += ["", f"## {title.replace('&', '')}", "", "| keys | action |", "| --- | --- |"]
        for row, keys in rows:
            if keys:
                lines.append(f"| `{keys}` | {row.text.partition(chr(9))[0].replace('&', '').rstrip('…')} |")
        if title == "&Analysis":
            lines += [f"| `{tab.shortcut}` | {tab.title.replace('&', '')} |" for tab in OWN_TABS.values()]
    lines += ["", "## Mouse", "", "| gesture | what |", "| --- | --- |"]
    lines += [f"| {gesture} | {meaning} |" for gesture, meaning in MOUSE]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
