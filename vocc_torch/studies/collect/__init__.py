"""``task=collect``."""
