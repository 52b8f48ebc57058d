"""Commands whose help shows a switch as a switch: ``--radar``, not ``--radar <bool>``, which nobody may type."""

from __future__ import annotations

from typing import Any

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
        return super().command(name, cls=PlainCommand, **settings)
