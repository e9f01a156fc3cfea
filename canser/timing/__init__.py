"""Private: the clocks of devices and of the host, and what a clock's restart is."""
