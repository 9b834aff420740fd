"""Measurement of a plan: simulate, locate, read, train, count, compare and time."""
