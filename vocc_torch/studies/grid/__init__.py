"""``task=test`` on a grid of two quantities."""
