"""Counting bit errors and saying what the counts prove."""
