"""Private: the clocks of devices and of the host, and the rule for a clock's restart."""
