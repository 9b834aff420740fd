"""From a plan to what was measured: simulate, locate, read, train, count, compare and time."""
