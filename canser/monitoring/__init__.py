"""Private: the live table of a port by id: its rows, its widgets, its application."""
