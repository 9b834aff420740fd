"""Showing results: terminal, CSV file, plots, TensorBoard."""
