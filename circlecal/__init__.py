"""Calibrate a sports camera from circular field markings.

>>> import circlecal
>>> calibration = circlecal.calibrate("frame.jpg")  # doctest: +SKIP
>>> calibration.status, calibration.H_image_field  # doctest: +SKIP
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

__all__ = ["Calibration", "Config", "__version__", "calibrate", "load_config"]

if TYPE_CHECKING:
    from circlecal.api import calibrate
    from circlecal.config import Config, load_config
    from circlecal.results import Calibration

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment variables that libraries of linear algebra read when they are loaded. The systems here are small, and
threads that wait for each other only cost time.
"""
_HOMES = {
    "Calibration": "circlecal.results",
    "Config": "circlecal.config",
    "calibrate": "circlecal.api",
    "load_config": "circlecal.config",
}


def __getattr__(name: str) -> Any:
    """Import the public names when they are first used, so that ``import circlecal`` costs nothing."""
    if name not in _HOMES:
        raise AttributeError(f"module 'circlecal' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
