"""How uncertain errors and predictions are, as a metrologist states it: budget, expanded uncertainty, conformity."""

from kilter_core.evaluate.uncertainty.budget import Budget, PermissibleError
from kilter_core.evaluate.uncertainty.conformity import Conformity, judge

__all__ = ["Budget", "Conformity", "PermissibleError", "judge"]
