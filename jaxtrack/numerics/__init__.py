"""Safe and masked maths, assignment, bijectors and entry checks; the floor everything stands on.

`safe` has elementary functions with finite gradients at their singular points and the reductions
that are right under `jit(grad)`; `masked` has reductions that ignore padding; `assignment` has the
linear assignment problem; `bijectors` takes constrained parameters to the reals and back; `checks`
words the errors of shapes, dtypes and static arguments; `segments` scans over many looks with
gradients that take little memory.
"""

from jaxtrack.numerics.assignment import Assignment, assign, pair_up
from jaxtrack.numerics.bijectors import (
    Bijector,
    bijector_of,
    bounded,
    identity,
    positive,
    simplex,
)
from jaxtrack.numerics.checks import check_array, check_choice, check_size
from jaxtrack.numerics.choice import choose, greater, step
from jaxtrack.numerics.definite import (
    definite_inverse,
    rounding_floor,
    scaled_cholesky,
    scaled_inverse,
    scaled_root,
)
from jaxtrack.numerics.masked import (
    masked_argmax,
    masked_argmin,
    masked_logsumexp,
    masked_max,
    masked_mean,
    masked_min,
    masked_sum,
)
from jaxtrack.numerics.safe import (
    as_float,
    safe_arctan2,
    safe_divide,
    safe_log,
    safe_max,
    safe_min,
    safe_norm,
    safe_sinc,
    safe_sqrt,
    take_along,
    wrap_angle,
)
from jaxtrack.numerics.segments import costly, decided, scan_in_segments

__all__ = [
    "Assignment",
    "Bijector",
    "as_float",
    "assign",
    "bijector_of",
    "bounded",
    "check_array",
    "check_choice",
    "check_size",
    "choose",
    "costly",
    "decided",
    "definite_inverse",
    "greater",
    "identity",
    "masked_argmax",
    "masked_argmin",
    "masked_logsumexp",
    "masked_max",
    "masked_mean",
    "masked_min",
    "masked_sum",
    "pair_up",
    "positive",
    "rounding_floor",
    "safe_arctan2",
    "safe_divide",
    "safe_log",
    "safe_max",
    "safe_min",
    "safe_norm",
    "safe_sinc",
    "safe_sqrt",
    "scaled_cholesky",
    "scaled_inverse",
    "scaled_root",
    "scan_in_segments",
    "simplex",
    "step",
    "take_along",
    "wrap_angle",
]
