"""Commands whose help shows a switch as a switch: ``--radar``, not ``--radar <bool>``, which nobody may type; whose
options stand in named groups where there are many; and that leave it to those who read a file or folder to say that its
permissions forbid that.
"""

from __future__ import annotations

from copy import copy
from typing import Any, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup

INPUT, CAMERA_AND_FIELD, OUTPUT, RUNNING = GROUPS = "Input", "Camera and field", "Output", "Running"
"""Groups of options on a page of help, in this order."""
FEW = 12
"""So many options need no groups."""


def _group_options(params: list[Any]) -> list[Any]:
    """Parameters as a page of help shows them: options by their groups, in one where they are few."""

    def is_option(param: Any) -> bool:
        return bool(param.param_type_name == "option")

    is_long = sum(map(is_option, params)) > FEW

    def put(param: Any) -> Any:
        shown = copy(param)
        if is_option(param):
            named = RUNNING if param.name == "help" else param.rich_help_panel
            shown.rich_help_panel = named if is_long else None
        return shown

    return sorted(map(put, params), key=lambda param: (*GROUPS, None).index(getattr(param, "rich_help_panel", None)))


def _hide_types_of_switches(params: list[Any]) -> list[Any]:
    for param in params:
        if getattr(param, "is_flag", False) and param.metavar is None:
            param.metavar = ""
    return params


class PlainCommand(TyperCommand):
    """A command."""

    _is_help = False

    def get_params(self, ctx: Any) -> list[Any]:
        """Its options and arguments."""
        params = _hide_types_of_switches(super().get_params(ctx))
        return _group_options(params) if self._is_help else params

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write its page of help."""
        self._is_help = True
        super().format_help(ctx, formatter)
        self._is_help = False


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
