"""Outside formats: pictures, masks and result files; one module per format."""
