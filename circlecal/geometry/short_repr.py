"""How results that hold arrays print: short, with the shapes of large arrays in the place of their numbers."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

SHOWN_ENTRIES = 9
"""Arrays up to this size, a 3 x 3 matrix, are shown with their numbers."""
SHOWN_ITEMS = 4
"""Of longer tuples and mappings only how many items they have is shown."""


SHOWN_LETTERS = 320
"""Of what takes more room only the type is shown: a camera takes up to 300, and is shown."""


class ShortRepr:
    """Base of dataclasses, made with ``repr=False``, that print short.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @dataclass(repr=False)
    ... class Seen(ShortRepr):
    ...     name: str
    ...     points: np.ndarray
    >>> Seen("line", np.zeros((40, 2))), Seen("mark", np.array([640.0, 360.5]))
    (Seen(name='line', points=<array (40, 2)>), Seen(name='mark', points=[640.0, 360.5]))
    """

    __slots__ = ()

    def __repr__(self) -> str:
        shown = (f"{own.name}={_show(getattr(self, own.name))}" for own in fields(self))  # type: ignore[arg-type]
        return f"{type(self).__name__}({', '.join(shown)})"


def _show(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"<array {value.shape}>" if value.size > SHOWN_ENTRIES else str(value.tolist())
    if isinstance(value, tuple | list | dict) and len(value) > SHOWN_ITEMS:
        return f"<{type(value).__name__} of {len(value)}>"
    shown = repr(value)
    return f"<{type(value).__name__}>" if len(shown) > SHOWN_LETTERS else shown
