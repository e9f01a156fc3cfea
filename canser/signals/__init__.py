"""Private: databases, and the signals that they find in frames. `canser` has the public names."""
