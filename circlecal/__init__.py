"""Calibrate a sports camera from circular field markings.

>>> import circlecal
>>> frame = circlecal.calibrate("frame.jpg")  # doctest: +SKIP
>>> frame.to_field([[640, 360]])  # doctest: +SKIP
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

__all__ = [
    "Calibration",
    "CirclecalError",
    "Config",
    "ConfigError",
    "InputError",
    "Run",
    "ViewTransformer",
    "__version__",
    "calibrate",
    "calibrate_points",
    "calibrate_video",
    "load",
    "load_config",
    "track",
]

if TYPE_CHECKING:
    from circlecal.api import Calibration, Run, ViewTransformer, calibrate, calibrate_points, calibrate_video, load
    from circlecal.config import Config, load_config
    from circlecal.errors import CirclecalError, ConfigError, InputError
    from circlecal.tracking.calls import track

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment variables that libraries of linear algebra read when they are loaded. The systems here are small, and
threads that wait for each other only cost time.
"""
_HOMES = {
    **dict.fromkeys(("CirclecalError", "ConfigError", "InputError"), "circlecal.errors"),
    **dict.fromkeys(("Config", "load_config"), "circlecal.config"),
    **dict.fromkeys(("Calibration", "Run", "ViewTransformer", "load"), "circlecal.api"),
    **dict.fromkeys(("calibrate", "calibrate_points", "calibrate_video"), "circlecal.api"),
    "track": "circlecal.tracking.calls",
}


def __getattr__(name: str) -> Any:
    """Import the public names when they are first used, so that ``import circlecal`` costs nothing."""
    if name not in _HOMES:
        raise AttributeError(f"module 'circlecal' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
