"""The pictures of the paper's figures other than bit error rates, drawn from plain arrays."""
