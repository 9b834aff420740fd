"""Studies with their own research question: they use the core, and the core does not know them."""
