"""Data where no adapter is: traffic, faults of a line, a virtual adapter."""
