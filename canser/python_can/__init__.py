"""Plugins for python-can: a bus, and readers of captures. Loaded by python-can only."""
