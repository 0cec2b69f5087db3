from .errors import CorrectionError as CorrectionError
from .fit.scene_fit import fit_scene as fit_scene
from .fit.seen.measurement import TargetFrame as TargetFrame
from .maps.correction_map import CorrectionMap as CorrectionMap
from .maps.correction_map import build_correction_map as build_correction_map
from .maps.corrector import Corrector as Corrector
from .maps.dewarp import fit_dewarp as fit_dewarp
from .target.chessboard import Chessboard as Chessboard
