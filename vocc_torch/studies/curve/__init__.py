"""``task=test`` along an axis."""
