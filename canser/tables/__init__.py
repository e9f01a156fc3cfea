"""Private: frames as columns, for programs that know Arrow. `canser.table` is public."""
