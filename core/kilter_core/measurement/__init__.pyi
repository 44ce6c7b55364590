from .contacts import placements as placements
from .frames import Errors as Errors
from .kind import Block as Block
from .kind import Residual as Residual
from .rows import Measurement as Measurement
