"""Numerics: the numbers of the contact model and of the solver, the same for settling and trials.

References:
    MuJoCo, "Computation: constraint model" and "Modeling: solver parameters",
    https://mujoco.readthedocs.io
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from graspmap.errors import InvalidInputError


@dataclass(frozen=True, kw_only=True)
class Numerics:
    """How contacts are made of forces and how far their solver goes.

    The defaults agree with a step four times finer (`python -m studies reference`).

    Args:
        timestep_s: Time step.
        check_s: Time between two looks at the state (stalled? lost? at rest?), rounded to steps.
        solver_iterations: Of Newton's method, at most.
        solver_tolerance: Relative improvement at which the solver stops.
        impratio: Stiffness of friction over that of the normal force; the higher, the less creep.
        contact_time_s: Time constant with which a contact pushes bodies apart, critically damped.
        contact_impedance: Impedance of a contact when it begins, when it is full, and the
            penetration in metres at which it is full.
        table_friction: Coulomb friction of the objects on the table and on each other.
        torsional_friction_m: Torsional friction of the same, a length.
        hull_vertices: Vertices that the hull of a convex piece keeps, at most.

    Raises:
        InvalidInputError: A number is not finite or outside what is said above.
    """

    timestep_s: float = 0.002
    check_s: float = 0.02
    solver_iterations: int = 30
    solver_tolerance: float = 1e-6
    impratio: float = 10.0
    contact_time_s: float = 0.005
    contact_impedance: tuple[float, float, float] = (0.95, 0.99, 0.001)
    table_friction: float = 0.5
    torsional_friction_m: float = 0.005
    hull_vertices: int = 128

    def __post_init__(self) -> None:
        check_range(self, "timestep_s", 1e-5, 0.01)
        check_range(self, "check_s", self.timestep_s, 0.1)
        check_range(self, "solver_iterations", 1, 1000)
        check_range(self, "solver_tolerance", 0.0, 1e-2)
        check_range(self, "impratio", 0.1, 1e4)
        check_range(self, "contact_time_s", 1e-4, 0.1)
        check_range(self, "table_friction", 0.0, 10.0)
        check_range(self, "torsional_friction_m", 0.0, 1.0)
        check_range(self, "hull_vertices", 4, 10000)
        low, high, width = self.contact_impedance
        if not (0.0 < low <= high < 1.0 and 0.0 < width < 0.1):
            raise InvalidInputError(
                "contact_impedance",
                self.contact_impedance,
                "two shares in (0, 1), the second not below the first, and a length up to 0.1 m",
            )

    @property
    def steps_a_check(self) -> int:
        """Time steps between two looks at the state."""
        return max(1, round(self.check_s / self.timestep_s))

    def numerics(self) -> Numerics:
        """These numbers alone, without those of a subclass."""
        return Numerics(**{f.name: getattr(self, f.name) for f in fields(Numerics)})


def check_range(settings: object, name: str, low: float, high: float) -> None:
    """Refuse a field of a dataclass that is no number from ``low`` to ``high``.

    Raises:
        InvalidInputError: It is not.
    """
    value = getattr(settings, name)
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not math.isfinite(value) or not low <= value <= high:
        raise InvalidInputError(name, value, f"a number from {low:g} to {high:g}")
