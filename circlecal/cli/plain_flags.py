"""Commands whose help shows a switch as a switch: ``--radar``, not ``--radar <bool>``, which nobody may type; and that
leave it to those who read a file or folder to say that its permissions forbid that.
"""

from __future__ import annotations

from typing import Any, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup


def _hide_types_of_switches(params: list[Any]) -> list[Any]:
    for param in params:
        if getattr(param, "is_flag", False) and param.metavar is None:
            param.metavar = ""
    return params


class PlainCommand(TyperCommand):
    """A command."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Its options and arguments."""
        return _hide_types_of_switches(super().get_params(ctx))


class PlainGroup(TyperGroup):
    """A group of commands."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Its own options."""
        return _hide_types_of_switches(super().get_params(ctx))


class PlainTyper(typer.Typer):
    """An application all of whose commands are such."""

    def command(self, name: str | None = None, **settings: Any) -> Any:
        """Add a function as a command; as :meth:`typer.Typer.command` takes it."""
        register = super().command(name, cls=PlainCommand, **settings)

        def add(function: Any) -> Any:
            function.__annotations__ = get_type_hints(function, include_extras=True)
            for hint in function.__annotations__.values():
                for parameter in getattr(hint, "__metadata__", ()):
                    parameter.readable = False
            return register(function)

        return add
