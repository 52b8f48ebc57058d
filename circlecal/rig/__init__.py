"""Many frames of one standing camera: which frames belong together, what they share, and each frame again with it."""
