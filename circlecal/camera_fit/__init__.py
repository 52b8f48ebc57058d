"""Maximum a posteriori pinhole camera from everything that was seen in a frame (numpy; the stage ``camera`` calls
it).
"""
