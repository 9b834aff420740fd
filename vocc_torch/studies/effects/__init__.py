"""``task=effects``: what each effect costs and does."""
