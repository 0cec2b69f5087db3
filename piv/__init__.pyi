from .correlation.pair import evaluate_pair as evaluate_pair
from .correlation.settings import PivSettings as PivSettings
from .correlation.vector_field import VectorField as VectorField
from .errors import PivError as PivError
from .files.frame_file import read_frame as read_frame
