"""``task=classifiers``: many receivers on the same frames."""
