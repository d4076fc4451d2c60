"""Images that can be zoomed, pointed at and clicked."""
