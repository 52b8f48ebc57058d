"""``circlecal config``."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from circlecal.cli import options


def config(
    schema: Annotated[bool, typer.Option("--schema", help="Print the JSON schema instead.")] = False,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
) -> None:
    """Print the effective configuration as YAML, every option under its description; start your own file from it."""
    from circlecal.cli import console
    from circlecal.config import effective_yaml, json_schema

    chosen = options.choose_config(config, settings)
    console.print_text(json.dumps(json_schema(), indent=2) if schema else effective_yaml(chosen).removesuffix("\n"))
