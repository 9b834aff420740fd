"""What a user runs: train, test, decode."""
