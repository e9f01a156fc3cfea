"""Private: the live table of a port by id: the model, the widgets, the program."""
