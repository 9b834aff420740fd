"""What has a research question of its own: it uses the core, and the core does not know it."""
