"""Results on their way out and back in: the record of a frame, the log of a run, its index, summary and table."""
