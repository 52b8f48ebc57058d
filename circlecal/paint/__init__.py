"""One instrument for paint: profiles across markings, their middles and edges, ends, marks, colour and faint sums."""
