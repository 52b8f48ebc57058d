"""The field's metrics, and what is derived from them: which camera is right, by how much, and how surely."""
