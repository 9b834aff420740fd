"""The report on the paper: its figures of bit error rates, and the sections around everything."""
