"""Private: live ports: the line, the thread that reads it, frames with host times, sending."""
