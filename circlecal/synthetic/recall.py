"""Textures that the frames of a clip share are drawn once."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import numpy as np

P = ParamSpec("P")
R = TypeVar("R")


def recall(count: int) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Keep the last ``count`` results of a function that draws from a generator.

    Where it is asked again with the same arguments and a generator in the same state, it gives the kept result and
    leaves the generator in the state that drawing would have left it in: no answer changes. Results are not to be
    written to.
    """

    def decorate(draw: Callable[P, R]) -> Callable[P, R]:
        kept: OrderedDict[Any, tuple[R, Any]] = OrderedDict()

        @wraps(draw)
        def draw_or_recall(*args: P.args, **named: P.kwargs) -> R:
            rng = next(value for value in (*args, *named.values()) if isinstance(value, np.random.Generator))
            others = tuple(value for value in args if value is not rng)
            names = tuple((name, value) for name, value in named.items() if value is not rng)
            key = others, names, repr(rng.bit_generator.state)
            if key in kept:
                kept.move_to_end(key)
                result, rng.bit_generator.state = kept[key]
                return result
            result = draw(*args, **named)
            kept[key] = result, rng.bit_generator.state
            if len(kept) > count:
                kept.popitem(last=False)
            return result

        return draw_or_recall

    return decorate
