"""Private: live ports: the line, the thread that drains it, frames with host times, sending."""
