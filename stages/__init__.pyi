from .config import StagesTable as StagesTable
from .errors import StageError as StageError
from .keep_out import KeepOut as KeepOut
from .stage import Stage as Stage
from .states import AxisState as AxisState
