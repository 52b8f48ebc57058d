"""Which marking of the template is which line, arc or end that was seen."""
