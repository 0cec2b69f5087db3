from .config import StagesTable as StagesTable
from .errors import StageError as StageError
from .stage import Stage as Stage
from .states import AxisState as AxisState
