"""Projective geometry of circles, lines and pinhole cameras (pure numpy; conventions in this folder's README)."""
