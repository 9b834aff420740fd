"""``task=decode``."""
