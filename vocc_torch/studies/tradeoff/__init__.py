"""``task=tradeoff``: what accuracy costs in time."""
