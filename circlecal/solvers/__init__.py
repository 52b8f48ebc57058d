"""The other published ways to the same homography, one file each, with one signature (see README.md here).

A solver takes ``(observations, template, circle, rng)`` and returns a
:class:`~circlecal.solvers.interface.SolverResult`:
a homography, or a failure with its reason. Nothing is imported before a solver is asked for.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from circlecal.errors import ConfigError

if TYPE_CHECKING:
    import numpy as np

    from circlecal.field import Circle, FieldTemplate
    from circlecal.observations import Observations
    from circlecal.solvers.interface import IntrinsicsSolver, Solver, SolverResult

SOLVERS: dict[str, str] = {
    "great_axis": "circlecal.solvers.great_axis:solve",
    "footyvision": "circlecal.solvers.footyvision:solve",
    "magera_case1": "circlecal.solvers.magera_case1:solve",
    "magera_case2": "circlecal.solvers.magera_case2:solve",
    "magera_case3": "circlecal.solvers.magera_case3:solve",
    "alvarez_caselles": "circlecal.solvers.alvarez_caselles:solve",
    "gupta": "circlecal.solvers.gupta:solve",
    "chum_matas": "circlecal.solvers.chum_matas:solve",
    "chen_wu": "circlecal.solvers.chen_wu:solve",
    "huang_self_polar": "circlecal.solvers.huang_self_polar:solve",
    "tvcalib_like": "circlecal.solvers.tvcalib_like:solve",
    "pnl_like": "circlecal.solvers.pnl_like:solve",
    "circlecal": "circlecal.solvers.circlecal:solve",
    "circlecal_default": "circlecal.solvers.circlecal:solve_with_defaults",
}
"""Name -> module and function; ``circlecal_default`` does not know principal point, lens and surface."""
INTRINSICS: dict[str, str] = {
    "chen_wu": "circlecal.solvers.chen_wu:intrinsics",
    "huang_concentric": "circlecal.solvers.huang_concentric:intrinsics",
}
"""Methods that find the camera's inner geometry."""


def solver_names() -> tuple[str, ...]:
    """Names of all solvers, in the order of the tables."""
    return tuple(SOLVERS)


def load_solver(name: str) -> Solver:
    """Solver by name.

    Raises
    ------
    ConfigError
        Unknown name; the text lists the known ones.
    """
    if name not in SOLVERS:
        wrong = "finds intrinsics only; circlecal bench solvers runs it" if name in INTRINSICS else "is unknown"
        raise ConfigError(f"solver {name!r} {wrong}; known: {', '.join(SOLVERS)}")
    module, function = SOLVERS[name].split(":")
    return getattr(import_module(module), function)


def load_intrinsics_solver(name: str) -> IntrinsicsSolver:
    """Intrinsics method by name.

    Raises
    ------
    ConfigError
        Unknown name.
    """
    if name not in INTRINSICS:
        raise ConfigError(f"intrinsics method {name!r} is unknown; known: {', '.join(INTRINSICS)}")
    module, function = INTRINSICS[name].split(":")
    return getattr(import_module(module), function)


def solve_by_name(
    name: str, observations: Observations, template: FieldTemplate, circle: Circle, rng: np.random.Generator
) -> SolverResult:
    """Run one solver on the observations of one frame.

    Parameters
    ----------
    name : str
        One of :data:`SOLVERS`.
    observations : Observations
        What was seen.
    template : FieldTemplate
        The field.
    circle : Circle
        The circle that is meant.
    rng : numpy.random.Generator
        Source of random samples, for the solvers that draw some.

    Raises
    ------
    ConfigError
        Unknown name; nothing else is raised.
    """
    return load_solver(name)(observations, template, circle, rng)
