"""Simulated adapters, bus traffic, and faults of a line."""
