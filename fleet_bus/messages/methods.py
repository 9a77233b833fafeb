"""Methods and ways to cut by name: one list of each, which profiles, tubes, their schemas and the server share."""

from typing import Final, Literal, get_args

#: A method that a profile may ask for.
Method = Literal["calibrated", "set_membership", "residual_hull", "paper", "lti"]

#: The methods that a profile may ask for; ``default`` chooses one of the first two.
METHODS: Final[tuple[Method, ...]] = get_args(Method)

#: What a tube says when the limits and rates of the profile alone bound it, because there is no model.
FROM_LIMITS: Final = "limits"

#: The methods that a tube may say it comes from.
TUBE_METHODS: Final[tuple[str, ...]] = (*METHODS, FROM_LIMITS)

#: A way to cut sets by predicates.
CutMethod = Literal["zonotope", "constrained", "frobenius"]
