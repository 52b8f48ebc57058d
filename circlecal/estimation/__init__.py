"""The camera of one frame, from everything that was seen: names, contradictions, optima and worlds."""
