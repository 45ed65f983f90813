"""Parameters of scenarios: what each is by default depends on the body.

The defaults that a scenario documents are those for the paper's sphere, whose radius is 1 m and
whose sensors are 0.43 m apart. A body twice as large has lengths twice as long; what has to do with
the spacing of sensors grows with that.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, fields
from typing import Any

from anisomap.errors import InputError
from anisomap.simulation.bodies.body import Body
from anisomap.simulation.bodies.lattice import sphere

REACH = "reach"
SPACING = "spacing"


def parameter(default: float, unit: str, per: str) -> Any:
    """Declare a field of options whose default grows with the body.

    Parameters
    ----------
    default : float
        Its value for the paper's sphere.
    unit : str
    per : {"reach", "spacing"}
        Which length of the body it grows with.
    """
    return field(default=default, metadata={"unit": unit, "per": per})


def options_for(kind: type[Any], body: Body, given: Mapping[str, Any] | None = None) -> Any:
    """Make options for a body.

    Parameters
    ----------
    kind : type
        A dataclass of options.
    body : Body
    given : mapping of str to number, optional
        Parameters that are not to have their defaults.

    Returns
    -------
    An instance of `kind`.

    Raises
    ------
    InputError
        If there is no such parameter, or one makes no sense.
    """
    known = {entry.name: entry for entry in fields(kind)}
    values = dict(given or {})
    for name in values:
        if name not in known:
            raise InputError(
                f"{kind.__name__} has no parameter {name!r}; choose from {', '.join(known)}"
            )
    reference = sphere()
    for name, entry in known.items():
        per = entry.metadata.get("per")
        if per and name not in values:
            growth = getattr(body, per) / getattr(reference, per)
            values[name] = entry.default * growth
    return kind(**values)
