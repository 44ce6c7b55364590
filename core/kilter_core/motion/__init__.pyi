from .document import to_document as to_document
from .find import MotionReport as MotionReport
from .find import find_missing_torque as find_missing_torque
from .options import MotionOptions as MotionOptions
from .record import Log as Log
from .record import is_log as is_log
from .regressor import rigid_regressor as rigid_regressor
