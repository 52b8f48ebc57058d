"""Pictures, masks and videos on their way in: from files, patterns, lists, addresses and video frames."""
