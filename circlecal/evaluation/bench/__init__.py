"""Benchmarks: accuracy against the statistical limit, and speed against other libraries in the same run."""
