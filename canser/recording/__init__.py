"""Private: recordings of raw bytes with their times: written, read, repaired."""
