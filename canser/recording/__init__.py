"""Private: write, read and repair recordings, which are raw bytes with their times."""
