"""``task=figures``."""
