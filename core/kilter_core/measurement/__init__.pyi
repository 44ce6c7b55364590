from .contacts import placements as placements
from .kind import Block as Block
from .kind import Residual as Residual
from .metrics import Errors as Errors
from .rows import Measurement as Measurement
