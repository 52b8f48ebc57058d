"""Synthetic cameras, observations and frames with exact truth, for tests, benchmarks and samples."""
