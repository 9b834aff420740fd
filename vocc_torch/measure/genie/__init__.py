"""The decoder that knows the scene: what is possible."""
