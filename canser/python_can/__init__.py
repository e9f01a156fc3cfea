"""Plugins for python-can: a bus, readers and a writer of captures. Loaded by python-can only."""
