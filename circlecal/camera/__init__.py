"""Maximum a posteriori pinhole camera from everything that was seen in a frame; the stage ``camera`` calls it."""
