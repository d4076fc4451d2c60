"""The time strip: series computed in the background, marks in a recording, and export of a part of it."""
