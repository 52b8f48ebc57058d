"""The workbench in the browser: frames of a run, named and clicked by a person, calibrated while they watch."""
