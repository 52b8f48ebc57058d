"""Every frame of a clip: cameras on their tripods, motion between frames, markings in each, and a smoother over all."""
