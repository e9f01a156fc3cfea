"""Private: what frames say of a bus. `canser` has the public names."""
