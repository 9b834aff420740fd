"""``task=train``."""
