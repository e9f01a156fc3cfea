"""Private: bytes to frames and back, without I/O. `canser` has the public names."""
