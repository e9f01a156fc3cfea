"""Private: statistics of frames. `canser` has the public names."""
